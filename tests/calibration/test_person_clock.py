"""When videos began by the person, against videos of which it is known."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from moving_cameras import MATRIX, look, moved_world, project
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation
from walking_person import FPS, ROWS, walking

from jaxmocap.calibration import Calibration, _in_place, calibrate_in_place
from jaxmocap.calibration._calibrate import _moved
from jaxmocap.calibration._child import Solved
from jaxmocap.calibration._person_clock import PersonClock, person_clock
from jaxmocap.capture import Capture

FRAMES = 60


def shaken(generator: np.random.Generator, count: int) -> np.ndarray:
    """cam_from_world (3, count, 4, 4) of three handheld cameras some 30 degrees apart."""
    poses = []
    for angle in (-0.5, 0.0, 0.6):
        way = np.cumsum(0.004 * generator.normal(size=(count, 3)), axis=0)
        centres = np.array([4 * np.sin(angle), 1.5, 4 * np.cos(angle)]) + way
        targets = np.array([0.0, 1.0, 0.0]) + 0.02 * generator.normal(size=(count, 3))
        poses.append([look(c, target) for c, target in zip(centres, targets, strict=True)])
    return np.array(poses)


def filmed(late: tuple[float, ...], seed: int = 0, moves: bool = True, every: tuple[int, ...] = (1, 1, 1)):
    """A capture, as far as it is asked, whose cameras filmed so many frames later than they say, and its cameras; some
    have only one picture of `every` so many."""
    generator = np.random.default_rng(seed)
    joints, _, _ = walking(generator, FRAMES + 20)
    person = CubicSpline(np.arange(len(joints)) - 10, joints if moves else joints[:1].repeat(len(joints), 0))
    poses, keypoints = shaken(generator, FRAMES), np.zeros((3, FRAMES, 25, 3))
    frames = np.stack([np.arange(FRAMES) // step for step in every])
    for camera, step in enumerate(every):
        poses[camera] = poses[camera, step * frames[camera]]
        for frame in range(0, FRAMES, step):
            pixels = project(poses[camera, frame], person(frame + late[camera]))
            pixels += 1.5 * generator.normal(size=pixels.shape)
            wrong = generator.random(len(pixels)) < 0.05
            pixels[wrong] += 60 * generator.normal(size=(wrong.sum(), 2))
            shown = keypoints[camera, frame : frame + step]
            shown[:, ROWS, :2] = pixels
            shown[:, ROWS, 2] = generator.random(len(pixels)) > 0.1
    clocks = tuple(SimpleNamespace(seconds=np.arange(0, FRAMES, step) / FPS) for step in every)
    capture = SimpleNamespace(
        num_cameras=3, num_frames=FRAMES, fps=FPS, sizes=((960, 540),) * 3, offsets=(0.0, 0.0, 0.0),
        indices=clocks, video_frames=frames, camera_names=("left", "middle", "right"),
        keypoints=lambda camera, frame: keypoints[camera, frame],
    )  # fmt: skip
    places = np.stack([np.repeat(np.arange(3), FRAMES), frames.reshape(-1)], axis=1)
    lenses = np.tile(MATRIX, (3, 1, 1)), np.zeros((3, 5))
    return capture, Solved(capture.sizes, frames, places, poses.reshape(-1, 4, 4), *lenses, np.zeros((0, 3)), 4.0, {})


@pytest.mark.parametrize(
    ("seed", "late", "world"),
    [(0, (0.0, 0.5, -1.5), None), (1, (0.0, -2.7, 0.24), None), (2, (0.0, 0.0, 0.0), (0.3, [0.4, -1.0, 0.3]))],
    ids=["parts of frames", "frames", "none, in units of its own"],
)
def test_the_moments_are_found_to_a_tenth_of_a_frame(seed, late, world):
    capture, solved = filmed(late, seed)
    if world is not None:
        scale, turned = world
        rotation = Rotation.from_rotvec(turned).as_matrix()
        solved = replace(solved, poses=moved_world(solved.poses, scale, rotation, np.array([2.0, -1.0, 5.0])))
    found = person_clock(capture, solved)
    assert found is not None
    wrong = found.late * FPS - late
    np.testing.assert_allclose(wrong, 0, atol=0.1)
    assert (np.abs(wrong[1:]) < 4 * found.deviation[1:] * FPS).all()
    assert found.late[0] == found.deviation[0] == 0
    np.testing.assert_array_equal(found.known(1 / FPS), found.late)
    assert found.after <= found.before + 0.05


def test_a_slower_video_is_matched_by_its_own_pictures():
    late = (0.0, -0.6, 0.9)
    found = person_clock(*filmed(late, every=(1, 1, 2)))
    assert found is not None
    np.testing.assert_allclose(found.late * FPS, late, atol=0.2)


def test_of_a_person_who_stands_still_nothing_is_known():
    capture, solved = filmed((0.0, 0.5, -1.3), moves=False)
    found = person_clock(capture, solved)
    assert found is None or not found.known(1 / FPS).any()


def test_a_few_frames_with_keypoints_tell_nothing():
    capture, solved = filmed((0.0, 0.5, -1.3))
    every = capture.keypoints
    capture.keypoints = lambda camera, frame: every(camera, frame) if frame % 20 == 0 else None
    assert person_clock(capture, solved) is None


def test_more_than_a_fifth_of_a_second_is_not_guessed_at():
    assert person_clock(*filmed((0.0, 9.0, 0.0))) is None


def calibrated(small: Path, offsets: tuple[float, ...], monkeypatch) -> Calibration:
    """What calibrating the capture in place gives where the person tells these offsets."""
    picture, record = np.zeros((2, 2, 3), np.uint8), {"time": {"moved": True}}
    found = Calibration(Capture.open(small).cameras, record, {}, picture, {}, offsets)
    monkeypatch.setattr(_in_place, "calibrate", lambda opened, **_: found)
    return calibrate_in_place(small, replace=True)


def test_frames_are_matched_anew_where_the_moment_is_known_and_the_lines_are_written(small, monkeypatch):
    file = small / "capture.toml"
    text = file.read_text().replace("selected_frames = [0, 6]", "selected_frames = [2, 6]")
    file.write_text(text.replace("frames = 12", "frames = 11"))
    capture = Capture.open(small, with_cameras=False)
    frame = 1 / capture.fps

    def by(late: float, deviation: float) -> Capture:
        return _moved(capture, PersonClock(np.array([0.0, late]), np.array([0.0, deviation]), 1.0, 1.0))

    assert by(1.2 * frame, 0.3 * frame) is capture
    moved = by(1.2 * frame, 0.2 * frame)
    np.testing.assert_array_equal(moved.video_frames, [np.arange(1, 12), np.arange(11)])
    np.testing.assert_allclose(moved.offsets, [0, 1.2 * frame], atol=1e-6)
    assert calibrated(small, moved.offsets, monkeypatch).record["time"]["moved"]
    again = Capture.open(small, with_cameras=False)
    assert again.offsets == moved.offsets
    np.testing.assert_array_equal(again.video_frames, moved.video_frames)


@pytest.mark.parametrize("line", ["selected_frames = [0, 6]", "frames = 12"])
def test_offsets_stay_where_frames_that_are_named_would_no_longer_be_shared(line, small, monkeypatch):
    file = small / "capture.toml"
    lines = [one for one in file.read_text().splitlines() if one == line or "frames = " not in one]
    file.write_text("\n".join(lines))
    assert line in lines
    found = calibrated(small, (0.0, 0.1), monkeypatch)
    assert found.offsets == (0.0, 0.0)
    assert not found.record["time"]["moved"]
    assert Capture.open(small, with_cameras=False).offsets == (0.0, 0.0)
    assert found.folder is not None
    assert f'cameras = "{found.folder.name}"' in file.read_text()
