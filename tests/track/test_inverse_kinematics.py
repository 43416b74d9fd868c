"""A known pose from exact keypoints in two views."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxmocap._results import InputError
from jaxmocap.camera import project
from jaxmocap.character import Pose, clamp, landmark_positions, rest_pose
from jaxmocap.refiners import Shooting
from jaxmocap.track import inverse_kinematics, keypoint_rays

FRAME = 1
POINTS = {
    "nose": 0, "r_shoulder": 2, "r_elbow": 3, "r_wrist": 4, "l_shoulder": 5, "l_elbow": 6, "l_wrist": 7, "r_hip": 9,
    "r_knee": 10, "r_ankle": 11, "l_hip": 12, "l_knee": 13, "l_ankle": 14, "l_toe": 19, "l_heel": 21, "r_toe": 22,
    "r_heel": 24,
}  # fmt: skip
MIDDLES = {1: ("l_shoulder", "r_shoulder"), 8: ("l_hip", "r_hip")}


def keypoints_of(world, pose):
    """BODY_25 points of both views without error; eyes, ears and small toes are not found."""
    skeleton, view = world.character.skeleton, world.cameras.at(FRAME)
    places = np.asarray(landmark_positions(skeleton, pose))
    at = dict(zip(skeleton.landmark_names, places, strict=True))
    body = np.zeros((25, 3), np.float32)
    for name, index in POINTS.items():
        body[index] = at[name]
    for index, (left, right) in MIDDLES.items():
        body[index] = 0.5 * (at[left] + at[right])
    pixels, _ = project(view.intrinsics, view.cam_from_world, jnp.asarray(body))
    confidence = np.isin(np.arange(25), [*POINTS.values(), *MIDDLES]).astype(np.float32)
    return [np.concatenate([np.asarray(p), confidence[:, None]], 1) for p in pixels]


@pytest.fixture(scope="module")
def keypoints(world):
    return keypoints_of(world, world.pose(FRAME))


@pytest.fixture(scope="module")
def solve(world):
    def run(keypoints, where=""):
        return inverse_kinematics(world.character, world.cameras.at(FRAME), keypoints, Shooting(), where=where)

    return run


def landmark_errors(world, pose):
    skeleton = world.character.skeleton
    wanted = [skeleton.landmark_names.index(name) for name in POINTS]
    return np.linalg.norm(np.asarray(landmark_positions(skeleton, pose)) - world.truth.joints[FRAME], axis=1)[wanted]


def test_a_limb_that_no_start_comes_near_is_found(world):
    """Two starts for the whole body leave it to the limbs' own starts to fold this arm."""
    skeleton = world.character.skeleton
    angles = np.asarray(rest_pose(skeleton).angles).copy()
    for name, degrees in (("flex", 60), ("abd", 40), ("axial", 60)):
        angles[skeleton.dof_names.index(f"l_shoulder_{name}") - 6] = np.deg2rad(degrees)
    angles[skeleton.dof_names.index("l_elbow_flex") - 6] = np.deg2rad(80)
    pose = clamp(skeleton, Pose(world.pose(FRAME).root, jnp.asarray(angles)))
    view = world.cameras.at(FRAME)
    found, rms = inverse_kinematics(world.character, view, keypoints_of(world, pose), Shooting(), starts=2)
    wrist = skeleton.landmark_names.index("l_wrist")
    error = landmark_positions(skeleton, found)[wrist] - landmark_positions(skeleton, pose)[wrist]
    assert np.linalg.norm(error) < 0.02
    assert rms < 0.01


def test_known_pose_is_recovered(world, keypoints, solve):
    pose, rms = solve(keypoints)
    errors = landmark_errors(world, pose)
    assert errors.max() < 0.01
    assert errors.mean() < 0.003
    assert rms < 0.003
    skeleton = world.character.skeleton
    assert np.all((pose.angles >= skeleton.lower) & (pose.angles <= skeleton.upper))


def test_one_wrong_keypoint_is_outvoted(world, keypoints, solve):
    wrong = [keypoints[0].copy(), keypoints[1]]
    wrong[0][4, :2] += 60  # the right wrist, in one view
    errors = landmark_errors(world, solve(wrong)[0])
    assert np.delete(errors, list(POINTS).index("r_wrist")).max() < 0.03


def test_without_hips_the_root_is_found_from_eight_directions(world, keypoints, solve):
    hidden = [points.copy() for points in keypoints]
    for points in hidden:
        points[[8, 9, 12], 2] = 0
    errors = landmark_errors(world, solve(hidden)[0])
    assert np.delete(errors, [list(POINTS).index(name) for name in ("l_hip", "r_hip")]).max() < 0.03


@pytest.mark.parametrize("missing", ["one view", "all but two points"])
def test_too_few_points_are_refused_in_a_sentence(keypoints, solve, missing):
    if missing == "one view":
        spoilt, count = [keypoints[0], None], 0
    else:
        spoilt, count = [points.copy() for points in keypoints], 2
        for points in spoilt:
            points[2:8, 2] = points[9:, 2] = points[0, 2] = 0
    with pytest.raises(
        InputError, match=rf"^frame 7 of 'x': {count} keypoints are seen by two cameras, .*three are needed"
    ):
        solve(spoilt, "frame 7 of 'x'")


def test_rays_of_the_truth_have_no_residual(world, keypoints):
    lines = keypoint_rays(world.character, world.cameras.at(FRAME), keypoints)
    assert lines.weight.shape == (2 * (len(POINTS) + len(MIDDLES)),)
    np.testing.assert_allclose(np.asarray(lines.mix).sum(1), 1, atol=1e-6)
    residual = np.asarray(lines(world.character, world.pose(FRAME))) * 0.02  # in metres
    assert np.abs(residual).max() < 2e-4


def test_unseen_points_make_no_rows(world, keypoints):
    half = [keypoints[0].copy(), None]
    half[0][:10, 2] = 0
    lines = keypoint_rays(world.character, world.cameras.at(FRAME), half)
    assert lines.weight.shape == (sum(index >= 10 for index in POINTS.values()),)
    nothing = keypoint_rays(world.character, world.cameras.at(FRAME), [None, None])
    np.testing.assert_array_equal(nothing(world.character, world.pose(FRAME)), 0)
