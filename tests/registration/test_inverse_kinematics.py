"""A known pose from exact keypoints in two views."""

import jax.numpy as jnp
import numpy as np
import pytest
from synthetic_world import POINTS

from jaxmocap._results import InputError
from jaxmocap.character import Pose, clamp, landmark_positions, rest_pose, retract
from jaxmocap.refiners import Shooting
from jaxmocap.registration import inverse_kinematics

FRAME = 1


def keypoints_of(world, pose):
    return list(world.keypoints(FRAME, pose))


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


@pytest.mark.slow
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


@pytest.mark.slow
def test_one_wrong_keypoint_is_outvoted(world, keypoints, solve):
    wrong = [keypoints[0].copy(), keypoints[1]]
    wrong[0][4, :2] += 60  # the right wrist, in one view
    errors = landmark_errors(world, solve(wrong)[0])
    assert np.delete(errors, list(POINTS).index("r_wrist")).max() < 0.03


@pytest.mark.slow
def test_without_hips_the_root_is_found_from_eight_directions(world, keypoints, solve):
    hidden = [points.copy() for points in keypoints]
    for points in hidden:
        points[[8, 9, 12], 2] = 0
    errors = landmark_errors(world, solve(hidden)[0])
    assert np.delete(errors, [list(POINTS).index(name) for name in ("l_hip", "r_hip")]).max() < 0.03


@pytest.mark.slow
def test_one_view_is_enough_for_the_person_to_stand_where_he_does(world, keypoints, solve):
    """What the view shows is met; depth, which only the size of the body tells, is near."""
    pose, rms = solve([keypoints[0], None])
    assert rms < 0.01
    found, truth = np.asarray(landmark_positions(world.character.skeleton, pose)), world.truth.joints[FRAME]
    assert np.linalg.norm(found.mean(0) - truth.mean(0)) < 0.12
    assert landmark_errors(world, pose).mean() < 0.15


@pytest.mark.slow
def test_the_side_a_single_view_shows_is_found(world, solve):
    """A body turned by any angle about the vertical faces the same way afterwards."""
    skeleton = world.character.skeleton
    base = world.pose(FRAME)
    for turn in (0.5, 2.0, 3.5, 5.0):
        true = retract(skeleton, base, jnp.zeros(39).at[4].set(turn))
        pose, _ = solve([keypoints_of(world, true)[0], None])
        ahead = np.asarray(pose.root[:3, :3]) @ np.asarray(true.root[:3, :3]).T
        assert np.degrees(np.arccos(np.clip((np.trace(ahead) - 1) / 2, -1, 1))) < 45, turn


@pytest.mark.parametrize("missing", ["hips in the only view", "all but two points"])
def test_too_few_points_are_refused_in_a_sentence(keypoints, solve, missing):
    if missing == "hips in the only view":
        spoilt, count = [keypoints[0].copy(), None], 0
        spoilt[0][[9, 12], 2] = 0
    else:
        spoilt, count = [points.copy() for points in keypoints], 2
        for points in spoilt:
            points[2:8, 2] = points[9:, 2] = points[0, 2] = 0
    with pytest.raises(
        InputError, match=rf"^frame 7 of 'x': {count} keypoints are seen by two cameras, .*three are needed"
    ):
        solve(spoilt, "frame 7 of 'x'")
