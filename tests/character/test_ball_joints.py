"""Two sets of angles, one rotation."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxmocap.character import Pose, away_from_limits, body_transforms, nearest_equivalent, rest_pose
from jaxmocap.character._pose import ball_joints, equivalent_angles
from jaxmocap.synthetic import make_capture


@pytest.fixture(scope="module")
def skeleton():
    return make_capture(1, (64, 48)).character.skeleton


def bent(skeleton, **degrees):
    angles = np.zeros(33, np.float32)
    for name, value in degrees.items():
        angles[skeleton.dof_names.index(name) - 6] = np.deg2rad(value)
    return Pose(rest_pose(skeleton).root, jnp.asarray(angles))


def test_shoulders_and_hips_are_ball_joints(skeleton):
    names = [skeleton.dof_names[6 + place.start] for place, _ in ball_joints(skeleton)]
    assert {"l_shoulder_flex", "r_shoulder_flex", "l_hip_flex", "r_hip_flex"} <= set(names)
    assert not any("clav" in name or "elbow" in name for name in names)


@pytest.mark.parametrize("seed", range(5))
def test_twins_are_the_same_rotation(skeleton, seed):
    rng = np.random.default_rng(seed)
    pose = Pose(rest_pose(skeleton).root, jnp.asarray(rng.uniform(-1.5, 1.5, 33), jnp.float32))
    angles, free = np.array(pose.angles), np.full(3, np.pi)
    for place, twice in ball_joints(skeleton):
        angles[place] = equivalent_angles(angles[place], twice, -free, free)
        assert np.abs(angles[place]).max() <= np.pi + 1e-6
    assert np.abs(angles - np.asarray(pose.angles)).max() > 1.0
    twin = body_transforms(skeleton, Pose(pose.root, jnp.asarray(angles)))
    np.testing.assert_allclose(twin, body_transforms(skeleton, pose), atol=2e-5)


@pytest.mark.parametrize("side", ["l", "r"])
def test_an_arm_walled_in_at_its_limit_is_given_room(skeleton, side):
    index = slice(skeleton.dof_names.index(f"{side}_shoulder_flex") - 6, None)
    limit = np.rad2deg(np.asarray(skeleton.upper)[index][0])
    pose = bent(
        skeleton, **{f"{side}_shoulder_flex": limit - 1, f"{side}_shoulder_abd": 60, f"{side}_shoulder_axial": 120}
    )
    found = away_from_limits(skeleton, pose)
    assert np.asarray(found.angles)[index][0] < np.deg2rad(limit - 100)
    np.testing.assert_allclose(body_transforms(skeleton, found), body_transforms(skeleton, pose), atol=2e-5)
    assert np.all((found.angles >= skeleton.lower) & (found.angles <= skeleton.upper))
    again = away_from_limits(skeleton, found)
    np.testing.assert_array_equal(again.angles, found.angles)
    np.testing.assert_allclose(nearest_equivalent(skeleton, found, pose).angles, pose.angles, atol=1e-5)


def test_a_pose_with_room_keeps_its_angles(skeleton):
    pose = bent(skeleton, l_shoulder_flex=40, r_shoulder_axial=-30, l_hip_flex=50)
    np.testing.assert_array_equal(away_from_limits(skeleton, pose).angles, pose.angles)
    np.testing.assert_array_equal(nearest_equivalent(skeleton, pose, pose).angles, pose.angles)
