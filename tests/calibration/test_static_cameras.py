"""Cameras that stand still, placed by a person who walks before them."""

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from filmed_square import SIZE, TOML, picture, write_video
from moving_cameras import centres_of, look
from scipy.spatial.transform import Rotation
from walking_person import Walk, detected, filmed_walk, walking

from jaxmocap._cli import run
from jaxmocap._results import InputError
from jaxmocap.calibration import _static_job
from jaxmocap.calibration._footage import VideoFootage
from jaxmocap.calibration._person_adjustment import PersonProblem, Rig
from jaxmocap.calibration._person_scene import Beliefs, Noise, believed_lengths, person_keypoints
from jaxmocap.calibration._standing import find_up
from jaxmocap.calibration._static_rig import StaticRig, find_static_rig, triangulate
from jaxmocap.calibration._stillness import _stillness
from jaxmocap.capture import Capture, check


def found(walk: Walk, focal_deviation: float = 0.15) -> StaticRig:
    cameras = len(walk.poses)
    guess = np.full(cameras, 0.9 * 960) if focal_deviation else walk.focal
    beliefs = Beliefs(guess, np.full(cameras, focal_deviation), 0.1, 0.5 / 30, believed_lengths({}))
    centre = np.tile(np.array(walk.size) / 2, (cameras, 1))
    names = [f"cam{camera}" for camera in range(cameras)]
    seen = person_keypoints(walk.keypoints, walk.seconds)
    return find_static_rig(seen, centre, beliefs, names, 0, lambda stage, done, total: None)


def turned(walk: Walk, rig: StaticRig, camera: int) -> tuple[float, float]:
    """Degrees by which a camera's orientation and its direction are wrong, as the first one sees them."""
    true, have = (poses[camera] @ np.linalg.inv(poses[0]) for poses in (walk.poses, rig.rig.cam_from_world))
    a, b = centres_of(true), centres_of(have)
    between = np.degrees(np.arccos(a @ b / np.linalg.norm(a) / np.linalg.norm(b)))
    return float(np.degrees(Rotation.from_matrix(true[:3, :3] @ have[:3, :3].T).magnitude())), float(between)


def test_of_a_long_capture_every_few_frames_count_but_all_are_read(tmp_path, monkeypatch):
    """Jumps and velocities are told by neighbours, which frames far apart are not."""
    monkeypatch.setattr(_static_job, "_MOST_FRAMES", 10)
    walk, names = filmed_walk(1, count=60), ("left", "right")
    frames = np.tile(np.arange(60), (2, 1))
    capture = SimpleNamespace(
        name="long", folder=tmp_path, keypoints_folder=tmp_path, num_frames=60, num_cameras=2, camera_names=names,
        keypoints=lambda camera, frame: walk.keypoints[camera, frame], video_frames=frames, offsets=(0.0, 0.0),
        indices=[SimpleNamespace(seconds=seconds) for seconds in walk.seconds], sizes=(walk.size,) * 2, fps=30.0,
    )  # fmt: skip
    matrices = np.tile(np.eye(3), (2, 1, 1))
    _static_job.write_static_job(capture, matrices, np.zeros((2, 5)), {}, tmp_path / "person.npz")
    with np.load(tmp_path / "person.npz") as job:
        assert job["keypoints"].shape[1] == job["seconds"].shape[1] == job["video_frames"].shape[1] == 60
        assert job["counted"].tolist() == list(range(0, 60, 6))


def test_two_cameras_with_unknown_lenses():
    walk = filmed_walk(1)
    rig = found(walk)
    turn, direction = turned(walk, rig, 1)
    assert turn < 3.0
    assert direction < 3.0
    assert np.abs(rig.rig.focal / walk.focal - 1).max() < 0.1
    assert turn < 4 * np.degrees(rig.angle_deviation.max())


@pytest.mark.slow
def test_three_cameras_with_known_lenses():
    walk = filmed_walk(2, (50.0, 120.0), count=150)
    rig = found(walk, 0.0)
    assert np.allclose(rig.rig.focal, walk.focal, rtol=1e-4)
    assert max(max(turned(walk, rig, camera)) for camera in (1, 2)) < 2.5


def test_the_jacobian_is_that_of_the_residuals():
    walk = filmed_walk(0, (40.0, 90.0), count=4)
    seen = person_keypoints(walk.keypoints, walk.seconds)
    rig = Rig(walk.poses @ np.linalg.inv(walk.poses[0]), walk.focal, np.zeros(3))
    centre = np.tile(np.array(walk.size) / 2, (3, 1))
    beliefs = Beliefs(walk.focal, np.full(3, 0.1), 0.05, 0.01, believed_lengths({}))
    points = triangulate(seen, rig, centre)
    problem = PersonProblem(seen, centre, rig, points, Noise(np.full(3, 4.0), 0.5), beliefs)
    values = problem.start + 0.03 * np.random.default_rng(0).normal(size=problem.size)
    numeric = np.stack(
        [
            (problem.residuals(values + step) - problem.residuals(values - step)) / 2e-6
            for step in 1e-6 * np.eye(problem.size)
        ],
        axis=1,
    )
    assert np.abs(problem.jacobian(values).toarray() - numeric).max() < 1e-4 * np.abs(numeric).max()


def test_what_does_not_tell_the_cameras_is_refused():
    still = filmed_walk(0, count=60)
    still.keypoints[:] = still.keypoints[:, :1]
    with pytest.raises(InputError, match="hardly moves"):
        found(still)
    few = filmed_walk(0, count=60)
    few.keypoints[:, 5:] = 0
    with pytest.raises(InputError, match="found at 5; run jaxmocap detect"):
        found(few)
    flat = filmed_walk(5, count=90)
    joints = flat.joints * [1.0, 1.0, 0.01]
    for camera, pose in enumerate(flat.poses):
        generator = np.random.default_rng(camera)
        flat.keypoints[camera] = detected(joints, np.zeros(90), pose, flat.focal[camera], flat.size, generator)
    with pytest.raises(InputError, match="one plane"):
        found(flat)


@pytest.mark.slow
def test_keypoints_of_other_moments_are_refused():
    others = filmed_walk(0, count=120)
    others.keypoints[1] = others.keypoints[1, ::-1]
    with pytest.raises(InputError, match="offset"):
        found(others)


def test_up_is_at_right_angles_to_the_ground_under_the_feet():
    joints, _, _ = walking(np.random.default_rng(0), 200)
    lean = Rotation.from_euler("xz", [0.3, -0.2])
    pose = look(np.array([3.0, 1.2, 1.0]), np.array([0.0, 0.9, 0.0]), roll=0.2)  # a tripod that is not level
    pose[:3, :3] = pose[:3, :3] @ lean.as_matrix().T
    gravity = find_up(pose[None], lean.apply(joints.reshape(-1, 3)).reshape(joints.shape) / 2, 2.0)
    assert np.degrees(np.arccos(gravity.up @ lean.apply([0, 1, 0]))) < 1.5
    assert gravity.ground is not None
    assert 2 * gravity.ground.offset == pytest.approx(0, abs=0.03)


def test_a_camera_that_stands_still_moves_or_is_moved(tmp_path):
    pose = look(np.array([0.6, 1.5, 4.0]), np.array([0.0, 0.9, 0.0]))
    aside = look(np.array([0.3, 1.5, 4.1]), np.array([0.1, 0.9, 0.0]))

    def judged(name: str, image) -> str:
        file = write_video(tmp_path / f"{name}.mp4", 18, image)
        return _stillness(VideoFootage(name, str(file), SIZE, 0, 17, tuple(range(18)), 430.0, False, False, {}, {}))

    def walked(number: int) -> np.ndarray:
        return look(np.array([0.6 - 0.01 * number, 1.5, 4.0]), np.array([0.0, 0.9, 0.0]))

    assert judged("tripod", lambda number: picture(pose)) == "still"
    assert judged("hand", lambda number: picture(walked(number))) == "moving"
    assert judged("wall", lambda number: np.full((*SIZE[::-1], 3), 200, np.uint8)) == "unknown"
    with pytest.raises(InputError, match="was moved between its frames"):
        judged("laid", lambda number: picture(pose if number < 9 else aside))


def capture_on_tripods(folder: Path, cameras: tuple[int, ...] = (0, 1), count: int = 40) -> tuple[Path, np.ndarray]:
    """Two videos of a square from tripods, with a person who is seen only by the detector of some cameras."""
    folder.mkdir()
    (folder / "capture.toml").write_text(TOML.replace('up = "y"', 'up = "y"\nkeypoints = "keypoints"'))
    (folder / "keypoints").mkdir()
    joints, heading, _ = walking(np.random.default_rng(1), count, 0.6)
    poses = np.array([look(np.array(at), np.array([0, 0.9, 0])) for at in ([1.5, 1.4, 4.2], [-3.0, 1.2, 3.4])])
    for camera, pose in enumerate(poses):
        image = picture(pose)
        write_video(folder / f"cam{camera}.mp4", count, lambda number, image=image: image)
        points = detected(joints, heading, pose, 430.0, SIZE, np.random.default_rng(camera))
        for frame in range(count if camera in cameras else 0):
            text = json.dumps({"people": [{"pose_keypoints_2d": points[frame].ravel().tolist()}]})
            (folder / "keypoints" / f"cam{camera}_{frame:05d}_keypoints.json").write_text(text)
    return folder, poses


def test_two_phones_on_tripods_are_calibrated_by_the_person(tmp_path, capsys):
    folder, true = capture_on_tripods(tmp_path / "square")
    assert run(["calibrate", str(folder), "--camera-distance", "4.57", "--focal", "cam0=430", "cam1=430"]) == 0
    cameras = Capture.open(folder).cameras
    poses = np.asarray(cameras.cam_from_world, float)
    assert poses.shape == (2, 40, 4, 4)
    assert np.allclose(poses, poses[:, :1])
    have, want = (one[1] @ np.linalg.inv(one[0]) for one in (poses[:, 0], true))
    assert np.degrees(Rotation.from_matrix(have[:3, :3] @ want[:3, :3].T).magnitude()) < 3
    assert np.linalg.norm(have[:3, 3]) == pytest.approx(4.57, rel=0.01)
    assert np.degrees(np.arccos(poses[0, 0, :3, 1] @ true[0, :3, 1])) < 4  # up, as the first camera sees it
    messages = [finding.message for finding in check(folder)]
    assert any("cam0 stands still and was placed by the person's keypoints" in message for message in messages)


def test_tripods_without_keypoints_in_both_are_told_what_to_do(tmp_path, capsys):
    folder, _ = capture_on_tripods(tmp_path / "one", cameras=(0,), count=20)
    assert run(["calibrate", str(folder), "--camera-distance", "4"]) == 2
    said = capsys.readouterr().err
    assert "only 'cam0' has any: run jaxmocap detect" in said
    assert run(["calibrate", str(folder), "--height", "1.7"]) == 2
    assert "cannot be measured in one view" in capsys.readouterr().err
    assert not (folder / "cameras").exists()
