"""Wrong and missing poses of a model whose cameras are known."""

import cv2  # before pycolmap
import numpy as np
import pycolmap
import pytest
from moving_cameras import FOCAL, centres_of, paths, project
from scipy.spatial.transform import Rotation

from jaxmocap._results import InputError
from jaxmocap.calibration import calibrate, refuse_gaps
from jaxmocap.calibration._features import Features
from jaxmocap.calibration._following import follow
from jaxmocap.calibration._footage import Footage, VideoFootage
from jaxmocap.calibration._registration import Model, Sightings
from jaxmocap.calibration._repair import repair
from jaxmocap.calibration._worker import write_result
from jaxmocap.capture import Capture

COUNT = 16
POSES = paths(COUNT)
WRONG, UNSEEN = [(0, 5), (1, 11)], (1, 4)


@pytest.fixture(scope="module")
def seen() -> tuple[Model, dict]:
    """Every frame placed by what it sees, with 10 % false sightings, except one that sees nothing."""
    generator = np.random.default_rng(0)
    names = ("cam0", "cam1")
    videos = tuple(
        VideoFootage(name, "", (960, 540), 0, COUNT - 1, tuple(range(COUNT)), FOCAL, False, False, {}, {})
        for name in names
    )
    reconstruction = pycolmap.Reconstruction()
    for camera in (1, 2):
        lens = pycolmap.Camera(camera_id=camera, model="SIMPLE_RADIAL", width=960, height=540)
        lens.params = [FOCAL, 480, 270, 0.0]
        reconstruction.add_camera_with_trivial_rig(lens)
    points = generator.uniform([-2, -0.3, -3], [2, 2.2, 1], (200, 3))
    ids = np.array([reconstruction.add_point3D(point, pycolmap.Track()) for point in points])
    blank = Features(np.zeros((0, 2), np.float32), np.zeros((0, 128), np.uint8))
    features = {(camera, frame): blank for camera in range(2) for frame in range(0, COUNT, 3)}
    model = Model(Footage(videos, seed=1), reconstruction, features)
    sightings = {}
    for camera in range(2):
        for frame in range(COUNT):
            pixels = project(POSES[camera, frame], points) + 0.3 * generator.normal(size=(200, 2))
            pixels[::10] += 80
            sightings[camera, frame] = Sightings(pixels, ids, np.arange(200), pixels)
    nothing = Sightings(np.zeros((0, 2)), np.zeros(0, int), np.zeros(0, int), np.zeros((0, 2)))
    sightings[UNSEEN] = nothing
    for place, what in sightings.items():
        found = model.place(place[0], what)
        assert (found is None) == (place == UNSEEN)
        if found is not None:
            model.add(place, found)
    return model, sightings


def test_wrong_poses_are_placed_again_and_missing_ones_filled_in(seen, tmp_path):
    model, sightings = seen
    for place in WRONG:
        image = model.reconstruction.images[model.images[place]]
        frame = model.reconstruction.frames[image.frame_id]
        pose = POSES[place]
        turned = Rotation.from_rotvec([0.0, 0.2, 0.0]).as_matrix() @ pose[:3, :3]
        moved = -turned @ (centres_of(pose) + [0.3, 0, 0])
        frame.set_cam_from_world(image.camera_id, pycolmap.Rigid3d(np.c_[turned, moved]))
    repairs = repair(model, sightings, lambda *_: None)
    assert repairs.outliers == WRONG
    assert sorted(repairs.placed_again) == WRONG
    assert repairs.interpolated == [UNSEEN]
    for camera in range(2):
        for frame in range(COUNT):
            pose = model.pose((camera, frame))
            error = np.linalg.norm(centres_of(pose) - centres_of(POSES[camera, frame]))
            assert error < (0.03 if (camera, frame) == UNSEEN else 0.005)

    write_result(model, repairs, tmp_path)
    with np.load(tmp_path / "result.npz") as result:
        places = [tuple(place) for place in result["places"].tolist()]
        assert places == [(camera, frame) for camera in range(2) for frame in range(COUNT)]
        at = places.index(UNSEEN)
        assert result["num_observations"][at] == 0
        assert np.isfinite(result["centre_deviation"]).all()
        assert result["centre_deviation"][at] > 2 * np.median(result["centre_deviation"])
        assert result["interpolated"].tolist() == [list(UNSEEN)]
        np.testing.assert_allclose(result["cam_from_world"][0], POSES[0, 0], atol=0.02)
    written = pycolmap.Reconstruction(tmp_path / "model")
    assert written.num_reg_images() == 2 * COUNT


def test_a_long_gap_is_refused_where_frames_are_wanted(small):
    capture = Capture.open(small)
    lost = {(1, frame) for frame in range(2, 9)}
    with pytest.raises(InputError, match="placed in 7 of 12 shared frames, at most at its frames 2 to 8 on end"):
        refuse_gaps(capture, lost, (0, None))
    refuse_gaps(capture, lost, (9, None))
    refuse_gaps(capture, lost, (0, 2))
    with pytest.raises(InputError, match="frames 9:3 are wanted, but the capture has 12 shared frames, 0 to 11"):
        calibrate(capture, camera_distance=1.0, frames=(9, 3))


def test_points_are_followed_into_a_picture_that_moved_by_known_pixels_and_lost_where_it_changed():
    noise = np.random.default_rng(0).normal(size=(480, 960))
    layers = [cv2.GaussianBlur(noise, (0, 0), width) for width in (2, 6, 18, 54)]  # as pictures have it: at all scales
    before = np.clip(128 + sum(20 * layer / layer.std() for layer in layers), 0, 255).astype(np.uint8)
    shift = np.array([3.25, -1.5], np.float32)
    after = cv2.warpAffine(before, np.array([[1, 0, shift[0]], [0, 1, shift[1]]]), (960, 480))
    after[:, 640:] = 255 - after[:, 640:]
    across, down = np.meshgrid(np.arange(60.5, 900, 20), np.arange(60.5, 420, 20))
    pixels = np.stack([across, down], -1).reshape(-1, 2).astype(np.float32)
    arrived, good = follow(before, after, pixels, within=0.5)
    kept = pixels[:, 0] < 400
    assert good[kept].mean() > 0.95
    assert np.abs(arrived - pixels - shift)[good & kept].max() < 0.1
    assert good[pixels[:, 0] > 660].mean() < 0.5
