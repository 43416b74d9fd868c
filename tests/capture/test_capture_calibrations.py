"""A capture takes cameras of every form, and writes them in every form that can hold them."""

from pathlib import Path

import numpy as np
import pytest

from jaxmocap import InputError
from jaxmocap.camera import FORMATS, read_cameras, write_cameras
from jaxmocap.capture import Capture, check

PLACES = dict.fromkeys(FORMATS, "model") | dict.fromkeys(("aniposelib", "pose2sim", "freemocap"), "rig.toml")
PLACES |= {"qualisys": "rig.qca.txt", "opencv": "rig.json"}


def _use(folder: Path, cameras: str) -> None:
    file = folder / "capture.toml"
    file.write_text(file.read_text().replace('cameras = "cameras"', f'cameras = "{cameras}"'))


@pytest.mark.parametrize("form", FORMATS)
def test_capture_toml_names_a_calibration_of_any_form(small: Path, form: str):
    before = Capture.open(small)
    write_cameras(before.cameras, small / PLACES[form], form, before.video_frames)
    _use(small, PLACES[form])
    after = Capture.open(small).cameras
    np.testing.assert_allclose(after.cam_from_world, before.cameras.cam_from_world, atol=2e-6)
    np.testing.assert_array_equal(after.intrinsics, before.cameras.intrinsics)
    assert not [finding for finding in check(small) if finding.severity == "error"]


def test_check_says_of_every_camera_what_is_wrong_with_its_calibration(small: Path):
    path = write_cameras(Capture.open(small).cameras, small / "rig.json", "opencv")
    path.write_text(path.read_text().replace('"R"', '"Q"'))
    _use(small, "rig.json")
    messages = [finding.message for finding in check(small) if finding.severity == "error"]
    assert [message.split(";")[0] for message in messages] == [
        "rig.json camera cam0 has no R",
        "rig.json camera cam1 has no R",
    ]


def test_a_real_rig_goes_through_every_form(data: Path, tmp_path: Path):
    cameras = Capture.open(data / "balance").cameras
    for form in FORMATS:
        (tmp_path / form).mkdir()
        path = write_cameras(cameras, tmp_path / form / PLACES[form], form)
        found = read_cameras(path, cameras.names, cameras.num_frames, cameras.sizes)
        np.testing.assert_allclose(found.cam_from_world, cameras.cam_from_world, atol=2e-6)
        np.testing.assert_array_equal(found.intrinsics, cameras.intrinsics)
        np.testing.assert_array_equal(found.distortion, cameras.distortion)


def test_handheld_cameras_are_refused_by_forms_for_tripods(data: Path, tmp_path: Path):
    capture = Capture.open(data / "plaza")
    with pytest.raises(InputError, match="holds one pose per camera: cam"):
        write_cameras(capture.cameras, tmp_path / "calib", "easymocap")
    path = write_cameras(capture.cameras, tmp_path / "model", "colmap-binary", capture.video_frames)
    assert path.is_dir()
