"""Imports flow one way: a package may import from the rows below its own, never sideways and never upwards."""

import ast
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1] / "jaxmocap"
ROWS = (
    ("__main__", "_cli", "__init__", "_public"),
    ("experiments",),
    ("pipeline",),
    ("baselines", "datasets", "annotation"),
    ("viewers",),
    ("exporters", "importers", "metrics"),
    ("calibration", "track"),
    ("clip",),
    ("verdict", "registration", "scan"),
    ("search", "refinement"),
    ("rigging",),
    ("energies", "samplers", "refiners", "motion"),
    ("observation",),
    ("appearance",),
    ("render", "character"),
    ("capture",),
    ("detection",),
    ("camera",),
    ("geometry",),
    ("_cache",),
    ("_files",),
    ("_shapes",),
    ("_types", "_results", "_runtime", "_spans"),
)
RANK: dict[str, float] = {name: row for row, names in enumerate(ROWS) for name in names}
RANK["synthetic"] = RANK["rigging"] + 0.5
HOST_LIBRARIES = {"cv2", "av", "trimesh", "pycolmap", "pygltflib"}
HOST_PACKAGES = {
    "detection",
    "calibration",
    "capture",
    "camera",
    "character",
    "rigging",
    "observation",
    "viewers",
    "synthetic",
    "appearance",
    "registration",
    "refinement",
    "scan",
    "search",
    "verdict",
    "pipeline",
    "_cli",
    "baselines",
    "datasets",
}
ARRAYS_ONLY = {"samplers", "refiners", "geometry"}


def unit_of(path: Path) -> str:
    """The package, or the module at the top, that a file belongs to."""
    first = path.relative_to(PACKAGE).parts[0]
    return first.removesuffix(".py")


@cache
def imported(path: Path) -> list[tuple[int, str]]:
    """Line and absolute name of everything a file imports, inside functions too, with relative imports resolved."""
    parts = ("jaxmocap", *path.relative_to(PACKAGE).parts[:-1])
    names = []
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names += [(node.lineno, alias.name) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            parent = parts[: len(parts) - node.level + 1] if node.level else ()
            base = ".".join([*parent, *([node.module] if node.module else [])])
            names += [(node.lineno, f"{base}.{alias.name}") for alias in node.names]
    return names


FILES = sorted(PACKAGE.rglob("*.py"))


def test_imports_go_down_the_rows_and_leave_private_modules_of_others_alone():
    wrong = []
    for path in FILES:
        unit = unit_of(path)
        for line, name in imported(path):
            parts = name.split(".")
            if parts[0] != "jaxmocap" or len(parts) < 2 or parts[1] == unit:
                continue
            where, other = f"{path.relative_to(PACKAGE)}:{line}", parts[1]
            if other not in RANK:
                wrong.append(f"{where} imports jaxmocap.{other}, which no row names")
            elif RANK[unit] > 0 and RANK[other] <= RANK[unit]:
                wrong.append(f"{where}: {unit} must not import {other}")
            if any(part.startswith("_") for part in parts[2:-1]):
                wrong.append(f"{where} reaches into {name}; import it from jaxmocap.{other}")
    assert not wrong, "\n".join(wrong)


def test_host_libraries_stay_in_host_packages():
    wrong = []
    for path in FILES:
        used = {name.split(".")[0] for _, name in imported(path)} & HOST_LIBRARIES
        if used and unit_of(path) not in HOST_PACKAGES:
            wrong.append(f"{path.relative_to(PACKAGE)} imports {', '.join(sorted(used))}")
    assert not wrong, "\n".join(wrong)


def test_samplers_and_refiners_know_neither_cameras_nor_bodies():
    for path in FILES:
        if unit_of(path) in ARRAYS_ONLY:
            units = {name.split(".")[1] for _, name in imported(path) if name.startswith("jaxmocap.")}
            assert units <= ARRAYS_ONLY | {"_types", "_results", "_shapes"}, path


def test_nothing_heavy_is_imported_until_a_name_is_used_and_track_is_public_in_either_order():
    """In one process, for most of the time goes into importing JAX."""
    code = """
import sys, jaxmocap

heavy = {'jax', 'cv2', 'numpy', 'scipy'} & set(sys.modules)
assert not heavy, heavy
jaxmocap.configure()
assert 'jax' not in sys.modules
jaxmocap.Pose
assert 'jax' in sys.modules
others = {f'jaxmocap.{name}' for name in ('pipeline', 'viewers', 'track', 'calibration')} & set(sys.modules)
assert not others, others
assert 'Pose' in dir(jaxmocap) and 'jaxmocap._public' not in sys.modules
for turn in (1, -1):
    for name in [name for name in sys.modules if name.split(".")[0] == "jaxmocap"]:
        del sys.modules[name]
    for line in ("from jaxmocap.track import track, motion_of", "import jaxmocap; jaxmocap.Tracker")[::turn]:
        exec(line)
    assert callable(jaxmocap.track) and jaxmocap.track is track
    assert motion_of
"""
    subprocess.run([sys.executable, "-c", code], check=True)


def test_unknown_public_names_are_attribute_errors():
    import jaxmocap

    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        _ = jaxmocap.nonsense
    assert "Capture" in dir(jaxmocap)
    assert jaxmocap.samplers.RandomSearch is jaxmocap.RandomSearch
