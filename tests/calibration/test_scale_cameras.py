"""Scaling the world of a capture's cameras: what they see stays, how large it is changes, and the reports say so."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

import jaxmocap as jm
from jaxmocap._cli import run
from jaxmocap.camera import read_colmap_points
from jaxmocap.synthetic import make_capture, write_capture

NAMES = ("cam0", "cam1")
RECORD = {
    "format": 1,
    "from": "background",
    "cameras": {name: {"centre_deviation_m": 0.01, "rotation_deviation_degrees": 0.1} for name in NAMES},
    "scale": {"from": "height", "relative_deviation": 0.04, "bones": 9, "frames": 3},
    "person": {
        "angle_degrees": 40.0,
        "across_m_per_pixel": 0.004,
        "depth_m_per_pixel": 0.02,
        "sentence": "before",
    },
}
TABLE = {"format": 1, "units": "metres"} | {name: {"frame": [0], "centre_deviation": [0.02]} for name in NAMES}


@pytest.fixture(scope="module")
def filmed(tmp_path_factory) -> Path:
    """A capture whose cameras are a model of the form that `calibrate` writes, with its two reports."""
    folder = write_capture(make_capture(2, (160, 90)), tmp_path_factory.mktemp("scaled") / "capture")
    capture = jm.Capture.open(folder)
    jm.write_cameras(capture.cameras, folder / "found", "colmap-binary", capture.video_frames)
    (folder / "found" / "calibration.json").write_text(json.dumps(RECORD))
    (folder / "found" / "uncertainty.json").write_text(json.dumps(TABLE))
    toml = folder / "capture.toml"
    toml.write_text(toml.read_text().replace('cameras = "cameras"', 'cameras = "found"'))
    return folder


@pytest.fixture
def film(filmed, tmp_path) -> Path:
    return Path(shutil.copytree(filmed, tmp_path / "capture"))


def test_positions_are_multiplied_and_nothing_else(film):
    before = jm.Capture.open(film)
    folder = jm.scale_cameras(film, 0.95)
    after = jm.Capture.open(film)
    assert after.cameras_path == folder != before.cameras_path
    assert before.cameras_path.is_dir()
    np.testing.assert_allclose(after.cameras.centres(), 0.95 * before.cameras.centres(), atol=1e-5)
    turned = [one.cameras.cam_from_world[..., :3, :3] for one in (before, after)]
    np.testing.assert_allclose(*turned, atol=1e-6)
    np.testing.assert_array_equal(after.cameras.intrinsics, before.cameras.intrinsics)
    points = (read_colmap_points(one)[0] for one in (before.cameras_path, folder))
    np.testing.assert_allclose(0.95 * next(points), next(points), atol=1e-6)
    assert (folder / "calibration.png").is_file()


def test_the_reports_are_scaled_with_them(film):
    folder = jm.scale_cameras(film / "capture.toml", 0.5)
    record, table = (json.loads((folder / f"{name}.json").read_text()) for name in ("calibration", "uncertainty"))
    assert record["cameras"]["cam0"] == {"centre_deviation_m": 0.005, "rotation_deviation_degrees": 0.1}
    assert record["person"]["depth_m_per_pixel"] == 0.01
    assert "1.0 cm in depth (5.0 times" in record["person"]["sentence"]
    assert record["scale"]["from"] == "height and outlines"
    assert record["scale"]["relative_deviation"] < RECORD["scale"]["relative_deviation"]
    assert table["cam1"] == {"frame": [0], "centre_deviation": [0.01]}


def test_cameras_of_another_form_are_refused_and_stay(film):
    toml = film / "capture.toml"
    toml.write_text(toml.read_text().replace('cameras = "found"', 'cameras = "cameras"'))
    shutil.move(film / "cameras", film / "text")
    shutil.copytree(film / "text", film / "cameras")
    before = sorted(film.rglob("*"))
    with pytest.raises(jm.InputError, match="not a model that calibrate wrote"):
        jm.scale_cameras(film, 0.9)
    assert sorted(film.rglob("*")) == before


@pytest.mark.parametrize("factor", [0.0, -1.0, float("nan")])
def test_what_scales_nothing_is_refused(factor, film):
    with pytest.raises(jm.InputError, match="a positive number was expected"):
        jm.scale_cameras(film, factor)


def test_reports_that_somebody_spoilt_are_named_and_nothing_changes(film):
    (film / "found" / "uncertainty.json").write_text("{}")
    before = sorted(film.rglob("*"))
    with pytest.raises(jm.InputError, match=r"are not what calibrate writes \(KeyError"):
        jm.scale_cameras(film, 0.9)
    assert sorted(film.rglob("*")) == before
    assert 'cameras = "found"' in (film / "capture.toml").read_text()


def test_the_command_needs_the_height_that_tells_the_scale(film, tmp_path, capsys):
    out = tmp_path / "fitted.glb"
    assert run(["fit-character", str(film), "--scale-cameras", "--out", str(out)]) == 2
    assert capsys.readouterr().err.startswith("jaxmocap: --scale-cameras scales the cameras to the person's height")
    assert not out.exists()
