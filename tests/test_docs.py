"""The documentation's code runs, and its tables say what the code does."""

import ast
import functools
import importlib.util
import inspect
import json
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmocap import exporters, samplers
from jaxmocap._cli import _run
from jaxmocap._results import InputError
from jaxmocap.appearance import AppearanceSettings, GridSettings
from jaxmocap.baselines import METHODS, Baseline, method
from jaxmocap.camera import FORMATS
from jaxmocap.capture import Capture
from jaxmocap.character import landmark_positions, rest_pose, retract, skin
from jaxmocap.character._dof_table import human_table
from jaxmocap.datasets import DATASETS, import_dataset, write_sequence
from jaxmocap.energies import GroupProblem, SearchEnergy, body_part, prepare_base, score_particles
from jaxmocap.importers._read_motion import SUFFIXES as MOTION_SUFFIXES
from jaxmocap.motion import Motion
from jaxmocap.observation import build_problem, observe, place_rectangle, projected_box, surface_of
from jaxmocap.pipeline import fit_capture_appearance
from jaxmocap.pipeline._doctor import _DECODERS
from jaxmocap.render import face_ids
from jaxmocap.rigging._read_mesh import SUFFIXES as MESH_SUFFIXES
from jaxmocap.synthetic import SyntheticCapture, make_capture, write_capture
from jaxmocap.track import track

ROOT = Path(__file__).parents[1]


def code_of(file: str, first_line: str) -> str:
    """The Python block that begins with this line."""
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / file).read_text(), re.DOTALL)
    return next(block for block in blocks if block.startswith(first_line))


def quick_start(capture: str) -> str:
    """The program of the reference, on another capture."""
    block = code_of("docs/reference.md", "import jaxmocap").replace('"plaza"', repr(capture))
    assert "jm.track(" in block
    return block


def run_block(path: str) -> dict:
    """What the block of CONTRIBUTING.md for this file defines, run as if it were that file."""
    names = {"__name__": path.removesuffix(".py").replace("/", ".")}
    exec(compile(code_of("CONTRIBUTING.md", f"# {path}"), path, "exec"), names)
    return names


@pytest.fixture(scope="module")
def shown() -> SyntheticCapture:
    return make_capture(3, (192, 108))


@pytest.fixture(scope="module")
def motion(shown) -> Motion:
    return Motion.from_poses(shown.character, shown.poses, [0, 1, 2], shown.timestamps)


@pytest.mark.slow
def test_the_steps_of_the_reference_track(tmp_path, monkeypatch):
    folder = write_capture(make_capture(3, (320, 180)), tmp_path / "capture")
    monkeypatch.chdir(tmp_path)
    names = {}
    exec(compile(quick_start(str(folder)), "docs/reference.md", "exec"), names)
    assert len(names["motion"]) == 3
    assert Motion.load("result").frames.tolist() == [0, 1, 2]


def test_the_tracker_with_an_added_energy_in_contributing_has_three_terms():
    names = run_block("jaxmocap/energies/_unexplained.py")
    exec(compile(code_of("CONTRIBUTING.md", "from dataclasses"), "CONTRIBUTING.md", "exec"), names)
    assert [term.name for term in names["tracker"].search_energy.terms][-1] == "unexplained"


def test_the_commands_of_the_readme_are_those_of_the_checks():
    commands = re.findall(r"^python3 -m venv .*$", (ROOT / "README.md").read_text(), re.MULTILINE)
    assert len(commands) == 2
    assert commands[1] in (ROOT / ".ci" / "run").read_text()


def test_the_command_line_takes_the_commands_of_the_pages(monkeypatch):
    for name, command in _run._COMMANDS.items():
        taken = functools.wraps(command)(lambda *arguments, **options: 0)
        monkeypatch.setitem(_run._COMMANDS, name, taken)
    pages = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
    blocks = [block for page in pages for block in re.findall(r"```sh\n(.*?)```", page.read_text(), re.DOTALL)]
    lines = [line for block in blocks for line in block.splitlines() if line.startswith("jaxmocap ")]
    assert len(lines) > 20
    for line in lines:
        assert _run.run(shlex.split(line, comments=True)[1:]) == 0, line


def test_the_energy_of_contributing_is_lowest_where_the_person_is(shown):
    term = run_block("jaxmocap/energies/_unexplained.py")["Unexplained"]()
    energy = SearchEnergy((term,))
    pose, cameras, character = shown.pose(0), shown.cameras, shown.character
    vertices = np.asarray(skin(character, pose))
    boxes = [
        projected_box(vertices, np.asarray(k), np.asarray(t[0]))
        for k, t in zip(cameras.intrinsics, cameras.cam_from_world, strict=True)
    ]
    rectangle = place_rectangle(np.stack(boxes), np.zeros(2), cameras.sizes)
    unlike = [rectangle.crop(mask.astype(np.float32), camera) for camera, mask in enumerate(shown.masks[0])]
    labels = [np.zeros((rectangle.height, rectangle.width), int)] * 2
    surface = surface_of(character, None, 2)
    problem = build_problem(list(shown.images[0]), rectangle, cameras, 0, vertices, surface, labels, unlike)
    part = body_part(character, tuple(range(6)))
    group = GroupProblem(character, part, pose, problem)
    base = prepare_base(energy, group, 16)
    moved = jnp.zeros((2, 39)).at[1, 0].set(0.15)
    scores = eqx.filter_jit(score_particles)(energy, group, base, moved, 4096)
    assert scores.needed <= 4096
    assert scores.terms[0, 0] < 0.1 < scores.terms[1, 0]


def test_the_sampler_of_contributing_finds_the_bottom_of_a_bowl():
    sampler = run_block("jaxmocap/samplers/_hill_climbing.py")["HillClimbing"](num_particles=40, num_iterations=15)
    target, limit = jnp.array([0.2, -0.1, 0.3]), jnp.ones(3)
    bowl = lambda particles: jnp.sum((particles - target) ** 2, axis=-1)  # noqa: E731
    found, info = samplers.run(sampler, bowl, jnp.zeros(3), 0.3 * limit, -limit, limit, jax.random.key(0))
    assert jnp.linalg.norm(found - target) < 0.1 * jnp.linalg.norm(target)
    assert info.steps.best_energy[-1] <= info.steps.best_energy[0]


def test_the_metric_of_contributing_is_the_way_of_a_sliding_character(shown):
    path_length = run_block("jaxmocap/metrics/_path_length.py")["path_length"]
    rest = rest_pose(shown.character.skeleton)
    poses = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (3, *leaf.shape)), rest)
    slid = eqx.tree_at(
        lambda p: p.root, poses, poses.root.at[:, :3, 3].set(jnp.array([[0, 0, 0], [0.3, 9, 0.4], [0, 0, 0]]))
    )
    motion = Motion.from_poses(shown.character, slid, [0, 1, 2], [0.0, 0.1, 0.2])
    assert path_length(motion) == pytest.approx(1.0, rel=1e-4)


def test_the_exporter_of_contributing_writes_every_frame(motion, tmp_path, monkeypatch):
    write_xyz = run_block("jaxmocap/exporters/_xyz.py")["write_xyz"]
    monkeypatch.setitem(exporters.EXPORTERS, ".xyz", exporters.Exporter(write_xyz, units="mm"))
    lines = exporters.export(motion, tmp_path / "joints.xyz", up="z").read_text().splitlines()
    count = len(motion.joint_names)
    assert lines[0] == str(count)
    assert lines[1].startswith("mm, z up, 0.000000 s")
    assert len(lines) == len(motion) * (count + 2)
    name, *place = lines[2].split()
    x, y, z = motion.joints[0, 0]
    assert name == motion.joint_names[0]
    np.testing.assert_allclose(np.array(place, float) / 1000, [x, -z, y], atol=1e-6)


def test_the_baseline_of_contributing_begins_as_the_frame_loop_asks_it_to(shown):
    still = run_block("jaxmocap/baselines/_still.py")["StandingStill"]()
    history = SimpleNamespace(pose=shown.pose(0))
    assert still.start(None, history, 0.1) is history.pose
    assert inspect.signature(type(still).start).parameters.keys() == inspect.signature(Baseline.start).parameters.keys()


def test_the_reader_of_contributing_makes_a_capture(shown, tmp_path):
    reader = run_block("jaxmocap/datasets/_tripods.py")["Tripods"]()
    made = Capture.open(write_capture(shown, tmp_path / "capture"))
    folder = tmp_path / "recordings" / "walk"
    folder.mkdir(parents=True)
    view, shift = shown.cameras.at(0), np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
    for number, name in enumerate(made.camera_names):
        shutil.copy(made.indices[number].path, folder / f"{name}.mp4")
        pose = np.asarray(view.cam_from_world[number], float)
        matrix = np.asarray(view.intrinsics[number], float) - shift
        np.savez(folder / f"{name}.npz", K=matrix, distortion=np.zeros(5), R=pose[:3, :3], t=pose[:3, 3])
    assert reader.sequences(folder.parent) == ["walk"]
    capture = Capture.open(write_sequence(reader.read(folder.parent, "walk"), tmp_path / "walk"))
    np.testing.assert_allclose(capture.cameras.intrinsics, view.intrinsics, atol=1e-3)
    np.testing.assert_allclose(capture.cameras.cam_from_world[:, 0], view.cam_from_world, atol=1e-5)
    np.testing.assert_array_equal(capture.image(1, 2), made.image(1, 2))


def test_the_lamp_of_contributing_bends_where_it_says():
    names = {}
    exec(
        compile(code_of("CONTRIBUTING.md", "import numpy as np\nfrom jaxmocap.character import Dof"), "lamp", "exec"),
        names,
    )
    lamp = names["lamp"]
    assert lamp.dof_names[6:] == ("turn", "lift", "nod")
    assert lamp.group("arm") == (6, 7, 8)
    lifted = retract(lamp, rest_pose(lamp), jnp.zeros(9).at[7].set(np.pi / 2))
    bulb = landmark_positions(lamp, lifted)[lamp.landmark_names.index("bulb")]
    np.testing.assert_allclose(bulb, (0, 0, 0.4), atol=1e-6)


def test_a_package_of_one_s_own_joins_the_tables_as_contributing_says(monkeypatch, motion, tmp_path):
    for table in (METHODS, DATASETS, exporters.EXPORTERS):
        for name in ("still", "uphill", "tripods", ".xyz"):
            monkeypatch.setitem(table, name, None)
            monkeypatch.delitem(table, name)
    names = {}
    files = ("baselines/_still.py", "samplers/_hill_climbing.py", "exporters/_xyz.py", "datasets/_tripods.py")
    for file in files:
        names |= run_block(f"jaxmocap/{file}")
    exec(compile(code_of("CONTRIBUTING.md", "# mylab/__init__.py"), "mylab", "exec"), names)
    assert isinstance(method("still", "draft"), names["StandingStill"])
    assert isinstance(method("uphill", "draft").sampler, names["HillClimbing"])
    assert exporters.export(motion, tmp_path / "a.xyz").is_file()
    with pytest.raises(InputError, match=r"no sequence of Tripods\. Get it from the shelf"):
        import_dataset("tripods", tmp_path, tmp_path / "out")


@pytest.mark.slow
def test_the_baseline_of_contributing_stays_where_it_was_registered(shown, tmp_path):
    still = run_block("jaxmocap/baselines/_still.py")["StandingStill"]()
    capture = Capture.open(write_capture(shown, tmp_path / "capture"))
    poses = {0: shown.pose(0)}
    settings = AppearanceSettings(grid=GridSettings(rows=8, columns=8))
    made = (capture, shown.cameras, shown.character)
    appearance = fit_capture_appearance(*made, poses, key=jax.random.key(0), settings=settings)
    tracked = track(observe(*made, appearance, poses), tracker=still, frames=(0, 2))
    assert len(tracked) == 2
    np.testing.assert_array_equal(tracked.angles[1], tracked.angles[0])
    np.testing.assert_array_equal(tracked.root[1], tracked.root[0])


def test_the_table_of_exports_is_the_code_s():
    text = (ROOT / "docs" / "conventions.md").read_text()
    rows = re.findall(
        r"^\| `(\.[\w.]+)` \| .+? \| (m|mm)(, fixed)? \| (y|z|the motion's)(, fixed)? \|", text, re.MULTILINE
    )
    expected = [
        (suffix, one.units, ", fixed" * one.fixed, one.up or "the motion's", ", fixed" * one.fixed)
        for suffix, one in exporters.EXPORTERS.items()
    ]
    assert rows == expected


def test_the_table_of_formats_names_all_that_are_written_and_read():
    text = (ROOT / "docs" / "reference.md").read_text()
    section = text.split("### Formats beside those of other programs")[1].split("\n\n")[1]
    rows = {cells[1].strip(): cells[2:] for line in section.splitlines()[2:] if (cells := line.split("|"))}
    written, read = (
        {name: re.findall(r"`([\w.-]+)`", cells[place]) for name, cells in rows.items()} for place in (0, 1)
    )
    assert set(written["calibration"]) == set(FORMATS)
    assert {*written["motion"], *written["model"], ".colmap"} == {*exporters.EXPORTERS, ".npz"}
    assert set(read["motion"]) == {*MOTION_SUFFIXES, ".npz"}
    assert set(read["model"]) == {*MESH_SUFFIXES, ".npz", ".vrm"}
    assert rows["video"][1].strip() == ", ".join(dict.fromkeys(_DECODERS.values()))
    assert all(len(cells) == 7 and all(cell.strip() for cell in cells[:-1]) for cells in rows.values())


def test_the_table_of_degrees_of_freedom_is_the_code_s():
    text = (ROOT / "docs" / "conventions.md").read_text()
    rows = re.findall(r"^\| `(\w+)` \| (\w+) \| (.+?) \| (-?\d+) to (-?\d+) \|$", text, re.MULTILINE)
    expected = [
        (dof.name, dof.joint, dof.positive, f"{dof.lower:g}", f"{dof.upper:g}")
        for dof in human_table("cmu7").dofs
        if not dof.name.startswith("r_")
    ]
    assert rows == expected


def test_the_pages_of_the_api_name_everything_public():
    from jaxmocap import _public

    pages = "".join(path.read_text() for path in (ROOT / "docs" / "api").glob("*.md"))
    shown = set(re.findall(r"^::: [\w.]+\.(\w+)$", pages, re.MULTILINE))
    public = {name for name, value in vars(_public).items() if callable(value)}
    assert public - shown == set()


def test_the_pages_of_the_api_name_what_the_documentation_s_code_imports():
    pages = "".join(path.read_text() for path in (ROOT / "docs" / "api").glob("*.md"))
    shown = set(re.findall(r"^::: [\w.]+\.(\w+)$", pages, re.MULTILINE))
    notebooks = [json.loads(path.read_text())["cells"] for path in (ROOT / "notebooks").glob("*.ipynb")]
    texts = ["".join(cell["source"]) for cells in notebooks for cell in cells if cell["cell_type"] == "code"]
    files = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").glob("*.md")]
    texts += [block for file in files for block in re.findall(r"```python\n(.*?)```", file.read_text(), re.DOTALL)]
    imports = [node for text in texts for node in ast.walk(ast.parse(text)) if isinstance(node, ast.ImportFrom)]
    public = [node for node in imports if re.fullmatch(r"jaxmocap(\.[a-z]\w*)*", node.module or "") and not node.level]
    named = {alias.name for node in public for alias in node.names}
    assert {"skin", "Dof", "METHODS"} < named
    assert named - shown == set()


def test_the_site_builds_without_a_warning(tmp_path):
    pytest.importorskip("mkdocstrings", reason="the extra 'docs' is not installed")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(tmp_path)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    for page, words in {"api/pipeline": "track_capture", "extending": "HillClimbing", "changes": "0.1.0"}.items():
        assert words in (tmp_path / page / "index.html").read_text()


def test_the_list_of_notebooks_names_them_all():
    listed = re.findall(r"^\| `(\d\d_\w+)` \|", (ROOT / "docs" / "notebooks.md").read_text(), re.MULTILINE)
    assert listed == sorted(path.stem for path in (ROOT / "notebooks").glob("*.ipynb"))


@pytest.fixture
def install(tmp_path, monkeypatch):
    """The first cell of the notebook for hosted machines, where jaxmocap is not installed: what pip is asked for."""
    cells = json.loads((ROOT / "notebooks" / "06_hosted_first_clip.ipynb").read_text())["cells"]
    first = "".join(next(cell for cell in cells if cell["cell_type"] == "code")["source"])
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    asked: list[list[str]] = []
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    monkeypatch.setattr(subprocess, "run", lambda command, check: asked.append(command))

    def run(source: str) -> str:
        monkeypatch.setenv("JAXMOCAP_SOURCE", source)
        exec(compile(first, "06_hosted_first_clip.ipynb", "exec"), {})
        return asked[-1][5]

    return run


@pytest.mark.parametrize(
    ("source", "wanted"),
    [
        ("https://example.org/jaxmocap.git", "jaxmocap[detect] @ git+https://example.org/jaxmocap.git"),
        ("git+ssh://example.org/jaxmocap", "jaxmocap[detect] @ git+ssh://example.org/jaxmocap"),
        ("https://example.org/jaxmocap-1.whl", "jaxmocap[detect] @ https://example.org/jaxmocap-1.whl"),
        ("jaxmocap-1.whl", "{here}/jaxmocap-1.whl[detect]"),
    ],
)
def test_the_hosted_notebook_installs_what_it_is_told(source, wanted, install):
    assert install(source) == wanted.replace("{here}", str(Path.cwd()))


def test_the_hosted_notebook_finds_a_wheel_or_the_repository_and_else_asks(install):
    with pytest.raises(RuntimeError, match="say in SOURCE where it is"):
        install("")
    (Path.cwd().parent / "jaxmocap").mkdir()
    assert install("") == f"{Path.cwd().parent}[detect]"
    Path("jaxmocap-0.1.0-py3-none-any.whl").touch()
    assert install("") == f"{Path.cwd()}/jaxmocap-0.1.0-py3-none-any.whl[detect]"


def test_the_hosted_notebook_shows_a_clip_of_a_single_frame(monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "tests" / "motion")
    from box_figure import box_character, box_motion

    cells = json.loads((ROOT / "notebooks" / "06_hosted_first_clip.ipynb").read_text())["cells"]
    (line,) = (line for cell in cells for line in cell["source"] if line.startswith("shown = "))
    for count, frames in ((1, [0]), (2, [0, 1]), (5, [0, 4])):
        names = {"motion": box_motion(box_character(), num_frames=count)}
        exec(line, names)
        assert names["shown"].frames.tolist() == frames


@pytest.mark.slow
def test_the_frame_that_notebooks_begin_with_shows_the_person(monkeypatch):
    """The notebooks themselves are long checks."""
    monkeypatch.syspath_prepend(ROOT / "notebooks")
    from one_frame import one_frame

    found = one_frame()
    assert found.image.shape == (180, 320, 3)
    ids = face_ids(
        skin(found.character, found.pose),
        found.character.faces,
        found.problem.intrinsics,
        found.problem.cam_from_world,
        found.problem.origins,
        *found.problem.size,
    )[0]
    foreign = np.asarray(found.problem.background) > 0.5
    assert foreign[np.asarray(ids) >= 0].mean() > 0.7
    assert foreign[np.asarray(ids) < 0].mean() < 0.1
