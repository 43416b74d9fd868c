"""`jaxmocap cameras`: listing, writing for another program, and taking cameras of one."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import jaxmocap as jm
from jaxmocap._cli import run
from jaxmocap.synthetic import make_capture, write_capture


@pytest.fixture(scope="module")
def films(tmp_path_factory) -> Path:
    return write_capture(make_capture(2, (160, 90)), tmp_path_factory.mktemp("films") / "capture")


@pytest.fixture
def film(films, tmp_path) -> Path:
    return Path(shutil.copytree(films, tmp_path / "capture"))


def refused(arguments: list[object], capsys) -> str:
    capsys.readouterr()
    assert run(["cameras", *map(str, arguments)]) == 2
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    return err


def pycolmap_names(folder: Path) -> set[str]:
    """The names of a model's images as COLMAP reads it, in a process of its own."""
    script = (
        "import sys, pycolmap; print(*(x.name for x in pycolmap.Reconstruction(sys.argv[1]).images.values()), sep='|')"
    )
    command = [sys.executable, "-c", script, str(folder)]
    done = subprocess.run(command, check=True, timeout=120, capture_output=True, text=True)
    return set(done.stdout.strip().split("|"))


def test_cameras_leave_a_capture_and_come_back(film, tmp_path, capsys):
    cameras = jm.Capture.open(film).cameras
    assert run(["cameras", str(film), "--to", "colmap-binary", "--out", str(tmp_path / "model"), "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert list(answer) == list(cameras.names)
    assert answer[cameras.names[0]]["focal_pixels"][0] == pytest.approx(float(cameras.intrinsics[0, 0, 0]))
    shutil.rmtree(film / "cameras")
    toml = film / "capture.toml"
    text = toml.read_text()
    toml.write_text(text.replace('cameras = "cameras"\n', ""))
    assert run(["cameras", str(film), "--from", str(tmp_path / "model")]) == 0
    again = jm.Capture.open(film)
    assert again.cameras_path == film / "cameras"
    np.testing.assert_allclose(again.cameras.cam_from_world, cameras.cam_from_world, atol=1e-5)
    assert jm.adopt_cameras(film, tmp_path / "model", replace=True) == film / "cameras-2"
    assert 'cameras = "cameras-2"' in toml.read_text()


def test_a_name_that_colmap_would_cut_at_a_blank_is_told(film, tmp_path, capsys):
    toml = film / "capture.toml"
    toml.write_text(toml.read_text().replace('name = "cam0"', 'name = "left phone"'))
    for file in (film / "cameras").glob("images.txt"):
        file.write_text(file.read_text().replace("cam0/", "left phone/"))
    assert run(["cameras", str(film), "--to", "colmap", "--out", str(tmp_path / "text")]) == 0
    assert "ends the images' names at a blank, as in 'left phone'; --to colmap-binary" in capsys.readouterr().err
    assert run(["cameras", str(film), "--to", "colmap-binary", "--out", str(tmp_path / "model")]) == 0
    assert "blank" not in capsys.readouterr().err
    names = pycolmap_names(tmp_path / "model")
    assert {name for name in names if "left" in name} == {"left phone/00000.png", "left phone/00001.png"}


def test_cameras_that_do_not_fit_are_refused_and_nothing_changes(film, tmp_path, capsys):
    before = {file: file.read_bytes() for file in film.rglob("*") if file.is_file()}
    assert "give both" in refused([film, "--to", "opencv"], capsys)
    assert "holds one pose per camera" in refused([film, "--to", "opencv", "--out", tmp_path / "rig.yml"], capsys)
    assert "names cameras already" in refused([film, "--from", film / "cameras"], capsys)
    other = write_capture(make_capture(2, (320, 180)), tmp_path / "other")
    assert "320x180" in refused([film, "--from", other / "cameras", "--replace"], capsys)
    assert "does not exist" in refused([film, "--from", tmp_path / "nowhere.toml", "--replace"], capsys)
    assert {file: file.read_bytes() for file in film.rglob("*") if file.is_file()} == before
    assert not (tmp_path / "rig.yml").exists()
