"""Single pictures of one place: their cameras, and what cannot be placed."""

import cv2
import numpy as np
import pytest
from filmed_square import FOCAL, SIZE, picture, walk

from jaxmocap._results import InputError
from jaxmocap.calibration import _pictures, calibrate_pictures
from jaxmocap.calibration._picture_worker import map_pictures
from jaxmocap.geometry import align_cameras, camera_residuals


def written(folder, pictures):
    files = [folder / f"WhatsApp Image {number} (1).png" for number in range(len(pictures))]
    for file, one in zip(files, pictures, strict=True):
        cv2.imwrite(str(file), one)
    return files


def test_cameras_are_found_up_to_a_similarity(tmp_path):
    true = walk(3, step=1.0).reshape(-1, 4, 4)
    files = written(tmp_path, [picture(pose) for pose in true])
    placed = calibrate_pictures(files, SIZE, guess=0.8 * FOCAL)
    assert placed.names == tuple(file.name for file in files)
    assert placed.left_out == ()
    found = np.asarray(placed.cameras.cam_from_world, np.float64)[:, 0]
    away, angle = camera_residuals(align_cameras(found, true), found, true)
    assert away.max() < 0.02
    assert np.degrees(angle).max() < 0.3
    assert np.asarray(placed.cameras.intrinsics)[:, 0, 0] == pytest.approx(FOCAL, rel=0.01)


@pytest.mark.slow
def test_pictures_without_anything_in_common_are_refused(tmp_path, monkeypatch):
    """Once by the child process, and once in this one."""
    rng = np.random.default_rng(1)
    noise = [cv2.GaussianBlur(rng.integers(0, 256, (240, 320)).astype(np.uint8), (0, 0), 1.5) for _ in range(6)]
    with pytest.raises(InputError, match=r"of 6 pictures \d could be placed"):
        calibrate_pictures(written(tmp_path, noise), (320, 240), guess=FOCAL)
    monkeypatch.setattr(_pictures, "run_worker", lambda task, folder, report: map_pictures(folder, report))
    flat = [np.full((240, 320), 128, np.uint8)] * 6
    with pytest.raises(InputError, match="show only 0 points"):
        calibrate_pictures(written(tmp_path, flat), (320, 240), guess=FOCAL)
