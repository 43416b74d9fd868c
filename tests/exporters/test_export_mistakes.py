"""What cannot be exported is refused with one sentence, and nothing is left behind."""

import contextlib
import importlib.util
import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import jaxmocap as jm
from jaxmocap._cli import run
from jaxmocap._results import InputError
from jaxmocap.exporters import EXPORTERS

NEEDED = {".parquet": "pyarrow", ".usd": "pxr", ".usda": "pxr", ".usdc": "pxr"}
BY_BLENDER = (".fbx", ".blend")  # test_export_blender.py has them
WRITABLE = [
    suffix
    for suffix in EXPORTERS
    if suffix not in BY_BLENDER and (suffix not in NEEDED or importlib.util.find_spec(NEEDED[suffix]))
]


@pytest.fixture(scope="module")
def result(even, tmp_path_factory) -> Path:
    return even.save(tmp_path_factory.mktemp("result") / "dance")


def test_the_command_writes_every_file_asked_for(result, even, tmp_path, capsys):
    files = [tmp_path / f"dance{suffix}" for suffix in WRITABLE]
    assert run(["export", str(result), "--to", *map(str, files), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)["files"]
    assert {Path(row["file"]) for row in told} == {*files, tmp_path / "dance_geometry", tmp_path / "dance_ik.xml"}
    assert len(told) == len(files) + 2
    assert all(file.exists() for file in files)
    assert {row["units"] for row in told} == {"m", "mm"}
    assert told[0]["frame_rate"] == pytest.approx(30)
    assert jm.export(result, tmp_path / "again.csv").read_text() == (tmp_path / "dance.csv").read_text()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--to", "dance.fly"], "the suffix .fly, which names no format; expected one of .glb, .bvh"),
        (["--to", "dance"], "has no suffix"),
        (["--to"], "--to names no file; give one at least"),
        (["--to", "dance.bvh", "--frame-rate", "0"], "the frame rate is 0; expected frames per second, more than 0"),
        (["--to", "dance.bvh", "--frame-rate", "nan"], "the frame rate is nan"),
        (["--to", "dance.glb", "--units", "cm"], ".glb files have units = m by definition"),
        (["--to", "dance.mot", "--up", "z"], ".mot files have up = y by definition"),
        (["--to", "dance.colmap", "--frame-rate", "60"], "leave the frame rate out"),
        (["--to", "a.bvh", "a.bvh"], "names a file twice"),
        (["--to", "a.bvh", "there.trc"], "there.trc exists already; choose a new file"),
        (["--to", "there.trc/a.bvh"], "cannot be written"),
        (["--to", "dance.glb", "--actor", "nobody.glb"], "the actor's file nobody.glb is not there"),
    ],
)
def test_a_mistake_is_one_sentence_and_leaves_nothing(arguments, words, result, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("there.trc").write_text("mine")
    assert run(["export", str(result), *arguments]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    assert words in err
    assert [path.name for path in tmp_path.iterdir()] == ["there.trc"]
    assert Path("there.trc").read_text() == "mine"


@contextlib.contextmanager
def room_for(size: int) -> Iterator[None]:
    """Let no file grow beyond some bytes, as on a full disk."""
    resource = pytest.importorskip("resource", reason="this system does not limit the size of files")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.parametrize("suffix", [suffix for suffix in WRITABLE if suffix not in (".osim", ".colmap")])
def test_a_full_disk_is_one_sentence_and_leaves_nothing(suffix, even, tmp_path):
    """Whether it is full from the start, half way, or at the last byte."""
    whole = jm.export(even, tmp_path / f"all{suffix}").stat().st_size
    for room in (0, 10, whole // 2, whole - 1):
        with room_for(room), pytest.raises(InputError, match="cannot be written"):
            jm.export(even, tmp_path / f"cut{suffix}")
    assert [path.name for path in tmp_path.iterdir()] == [f"all{suffix}"]


def test_what_is_no_result_is_refused(tmp_path, capsys):
    for folder in (tmp_path, tmp_path / "nowhere"):
        assert run(["export", str(folder), "--to", str(tmp_path / "a.bvh")]) == 2
        assert "there is no motion.npz in it" in capsys.readouterr().err


def test_units_that_are_none_are_refused_in_python_too(even, tmp_path):
    with pytest.raises(InputError, match="units are 'feet'; expected one of m, cm, mm"):
        jm.export(even, tmp_path / "a.bvh", units="feet")
    with pytest.raises(InputError, match="up is 'x'; expected y or z"):
        jm.export(even, tmp_path / "a.bvh", up="x")


def test_a_single_frame_can_be_exported_everywhere(even, tmp_path):
    for suffix in WRITABLE:
        assert jm.export(even[:1], tmp_path / suffix / f"one{suffix}").exists()
    assert np.isfinite(even.joints).all()
