"""Which pictures are matched with each other, and how large they are when they are looked at."""

from dataclasses import replace

import cv2  # noqa: F401  (before pycolmap: the other order crashes)
import numpy as np
import pycolmap
import pytest
from small_captures import make_video

from jaxmocap.calibration._footage import Footage, footage_of
from jaxmocap.calibration._mapping import _map, adjust
from jaxmocap.calibration._matching import frame_pairs, key_pairs
from jaxmocap.calibration._worker import _enlarge
from jaxmocap.capture import Capture

FAST, SLOW = 60, 30  # pictures a second
LATER = 0.5  # seconds by which the slow camera began later


@pytest.fixture(scope="module")
def footage(tmp_path_factory) -> Footage:
    """Four seconds of two phones, one of which takes twice as many pictures."""
    folder = tmp_path_factory.mktemp("rates") / "capture"
    folder.mkdir()
    make_video(folder / "fast.mp4", 4 * FAST, fps=FAST)
    make_video(folder / "slow.mp4", 4 * SLOW, fps=SLOW)
    cameras = "".join(
        f'[[camera]]\nname = "{name}"\nvideo = "{name}.mp4"\noffset = {offset}\n'
        for name, offset in (("fast", 0.0), ("slow", LATER))
    )
    (folder / "capture.toml").write_text(cameras)
    capture = Capture.open(folder)
    return footage_of(capture, None, (0, capture.num_frames), key_step=5, seed=0)


def moment(place: tuple[int, int]) -> float:
    camera, frame = place
    return frame / FAST if camera == 0 else LATER + frame / SLOW


def test_pictures_of_two_cameras_are_paired_by_time_whatever_their_rates(footage):
    across = [(one, other) for one, other in key_pairs(footage) if one[0] != other[0]]
    for frame in footage.key_frames(0):
        partners = [moment(other) for one, other in across if one == (0, frame)]
        at = np.clip(moment((0, frame)), LATER, LATER + 4 - 1 / SLOW)
        assert min(abs(time - at) for time in partners) < 5 / SLOW
        assert max(abs(time - at) for time in partners) < 1.6  # nine key frames, five pictures apart


def test_a_picture_between_is_placed_by_those_taken_nearest_to_it(footage):
    for camera, frame in ((0, 123), (1, 61)):
        for other in frame_pairs(footage, camera, frame):
            assert abs(moment(other) - moment((camera, frame))) < 10 / SLOW


def test_what_the_child_process_reads_is_what_was_written(footage, tmp_path):
    file = tmp_path / "job.json"
    file.write_text(footage.to_json())
    assert Footage.from_file(file) == footage


def test_large_pictures_are_made_as_large_as_everything_else_sees_them(footage):
    """Boxes and focal lengths with them; what is small enough is left alone."""
    assert footage.reduced() == footage
    large = replace(footage.videos[0], size=(3840, 2160), focal=3600.0, boxes={3: (400.0, 800.0, 1200.0, 2000.0)})
    small = large.reduced()
    assert (small.size, small.recorded_size, small.focal) == ((960, 540), (3840, 2160), 900.0)
    assert small.boxes == {3: (100.0, 200.0, 300.0, 500.0)}
    assert small.reduced() == small


def test_what_was_found_in_small_pictures_is_told_in_pixels_of_the_video(footage):
    reconstruction = pycolmap.Reconstruction()
    lens = pycolmap.Camera(camera_id=1, model="SIMPLE_RADIAL", width=64, height=48, params=[60.0, 32.0, 24.0, 0.1])
    reconstruction.add_camera_with_trivial_rig(lens)
    image = pycolmap.Image(name="fast/00000.png", keypoints=np.array([[10.0, 20.0]]), camera_id=1, image_id=1)
    reconstruction.add_image_with_trivial_frame(image, pycolmap.Rigid3d())
    recorded = replace(footage, videos=(replace(footage.videos[0], size=(128, 96)),))
    _enlarge(reconstruction, recorded)
    np.testing.assert_allclose(reconstruction.cameras[1].params, [120, 64, 48, 0.1])
    np.testing.assert_allclose(reconstruction.images[1].points2D[0].xy, [20, 40])


def test_one_thread_maps_and_adjusts_so_that_the_same_seed_gives_the_same_bits(footage, tmp_path, monkeypatch):
    threads = []

    def mapping(*_, options, **__):
        threads.append(options.num_threads)
        return {}

    def adjustment(_, options):
        threads.append(options.ceres.solver_options.num_threads)

    monkeypatch.setattr(pycolmap, "incremental_mapping", mapping)
    monkeypatch.setattr(pycolmap, "bundle_adjustment", adjustment)
    assert _map(footage, tmp_path / "database.db", tmp_path / "out", None, 1, lambda *_: None) is None
    model = pycolmap.Reconstruction()
    model.add_camera_with_trivial_rig(
        pycolmap.Camera.create_from_model_id(1, pycolmap.CameraModelId.SIMPLE_RADIAL, 900, 960, 540)
    )
    adjust(model, rounds=1)
    assert threads == [1, 1]
