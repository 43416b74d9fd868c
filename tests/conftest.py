"""What all tests share: run-time checks of array annotations, a cache of compiled programs, and the captures.

Settings of JAX and the import hook come first, before anything imports JAX or the package.
"""

import gc
import os
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from jaxtyping import install_import_hook

ROOT = Path(__file__).parents[1]
DATA = Path(os.environ.get("JAXMOCAP_DATA", ROOT.parent / "shared" / "data"))

SINGLE_FUNCTIONS = {
    *("camera", "character", "energies", "exporters", "geometry", "guard_rails", "importers", "metrics"),
    *("motion", "observation", "refiners", "rigging", "samplers", "synthetic"),
}
"""Folders of tests. Not of the rasterisers, whose drivers are held against each other bit by bit."""

SHORT_RUNS = {
    *("test_any_sampler", "test_colour_model", "test_descend", "test_doctor", "test_doubts", "test_filled_mesh"),
    *("test_hybrid", "test_inverse_kinematics", "test_keys", "test_soft_faces", "test_surface_flow"),
}
"""Files of tests beside these that run for a moment what takes long to compile; of the rasterisers only the soft one,
for the other files of that folder share programs."""

for _threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):  # a worker has a core: more would wait for one another
    os.environ.setdefault(_threads, "1")
os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(ROOT / ".pytest_cache" / "jax"))
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")
# A matrix product that leaves its precision to JAX has ten bits on a GPU. This one no CPU has: such a product fails.
os.environ.setdefault("JAX_DEFAULT_MATMUL_PRECISION", "TF32_TF32_F32")
os.environ["XDG_CACHE_HOME"] = str(ROOT / ".pytest_cache" / "user")
os.environ["JAXMOCAP_PROGRAMS"] = ""  # every program is traced, so that annotations are checked
from array_checks import leave_alone_what_names_no_array  # noqa: E402

leave_alone_what_names_no_array()
install_import_hook("jaxmocap", "array_checks.check_arrays")
import jaxmocap._runtime  # noqa: E402

jaxmocap._runtime.compile_sooner()  # as the command line and `configure` do
_quick_loops, _searched_for_long = jaxmocap._runtime.quick_loops, [False]
jaxmocap._runtime.quick_loops = lambda: _quick_loops() if _searched_for_long[0] else {}
if _quick_loops():  # a jaxlib whose flags are known; in one part, programs compile for less in all
    os.environ["XLA_FLAGS"] += " --xla_cpu_parallel_codegen_split_count=1"


@pytest.fixture(scope="session")
def data() -> Path:
    """The folder of example captures; tests that need it are skipped where it is absent."""
    if not DATA.is_dir():
        pytest.skip(f"the example captures are not in {DATA}; set JAXMOCAP_DATA to their folder")
    return DATA


@pytest.fixture(scope="session")
def world(tmp_path_factory: pytest.TempPathFactory):
    """The small synthetic world with a known answer that tests share, a `synthetic_world.World`."""
    from synthetic_world import shared_world

    return shared_world(tmp_path_factory)


@pytest.fixture(scope="session")
def videos(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The videos of `small`."""
    from small_captures import POSES, make_video

    folder = tmp_path_factory.mktemp("videos")
    for name in POSES:
        make_video(folder / f"{name}.mp4")
    return folder


@pytest.fixture
def small(tmp_path: Path, videos: Path) -> Path:
    """A complete, faultless capture of two cameras and 12 frames, to be spoilt by a test."""
    from small_captures import POSES, TOML, write_keypoints, write_mask, write_model

    folder = tmp_path / "small"
    folder.mkdir()
    for name in POSES:
        shutil.copy(videos / f"{name}.mp4", folder)
    (folder / "capture.toml").write_text(TOML)
    write_model(folder / "cameras", POSES, 12)
    for name in ("keypoints", "masks"):
        (folder / name).mkdir()
    for frame in (0, 6):
        for name, pose in POSES.items():
            write_keypoints(folder / "keypoints" / f"{name}_{frame:05d}_keypoints.json", pose)
            write_mask(folder / "masks" / f"{name}_{frame:05d}.png")
    return folder


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Notebooks are long checks: what the first does, the gate holds. The gate takes longest, so it begins first; where
    the example data brings a capture for it, the demo's is a long check, too."""
    for item in items:
        second_gate = item.path.name == "test_gate.py" and "demo" in item.name and DATA.is_dir()
        if item.path.suffix == ".ipynb" or second_gate:
            item.add_marker("slow")
    items.sort(key=lambda item: item.path.name != "test_gate.py")


@pytest.fixture(autouse=True)
def _nans_on_purpose(request: pytest.FixtureRequest) -> Iterator[None]:
    """Where JAX_DEBUG_NANS is set, tests with the marker `nans` are left out of it."""
    if request.node.get_closest_marker("nans") is None:
        yield
        return
    import jax

    with jax.debug_nans(False):
        yield


@pytest.fixture(scope="module", autouse=True)
def _compiled_sooner(request: pytest.FixtureRequest) -> Iterator[None]:
    """Tests of single functions compile for longer than they run: XLA leaves out what makes programs faster.
    Where people are tracked, and in child processes, programs are compiled as for users, but for the search: its quick
    loops, which take longer to compile, pay where many frames are tracked, in the gate."""
    import jax

    from jaxmocap._cache import free_programs

    folder = request.path.parent.name
    sooner = folder in SINGLE_FUNCTIONS or request.path.stem in SHORT_RUNS
    jax.config.update("jax_disable_most_optimizations", sooner)
    for_long = request.path.name == "test_gate.py"
    if for_long != _searched_for_long[0]:
        _searched_for_long[0] = for_long
        free_programs()  # options are read when a program is first traced
    yield
    jax.config.update("jax_disable_most_optimizations", False)


@pytest.fixture(scope="module", autouse=True)
def _forget_programs() -> Iterator[None]:
    """Drop the compiled programs of each file. Every one takes memory maps of the process, of which the kernel allows
    65,530; the whole suite needs more and would end in a segmentation fault."""
    yield
    import jax

    jax.clear_caches()
    gc.collect()
