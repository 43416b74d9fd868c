"""Increments: retract and difference are inverse, the root turns about the pelvis, clamping respects limits."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxmocap.character import (
    Pose,
    clamp,
    difference,
    pelvis_position,
    pose_from_vector,
    pose_vector,
    rest_pose,
    retract,
)


def increments(seed: int, count: int = 2) -> np.ndarray:
    return np.random.default_rng(seed).normal(0, 0.7, (count, 39))


def test_difference_undoes_retract(box_figure):
    skeleton = box_figure.skeleton
    start, delta = increments(0)
    pose = pose_from_vector(skeleton, jnp.asarray(start))
    moved = retract(skeleton, pose, jnp.asarray(delta))
    np.testing.assert_allclose(difference(skeleton, pose, moved), delta, atol=2e-6)
    np.testing.assert_allclose(pose_vector(skeleton, pose), start, atol=2e-6)


def test_retract_by_difference_reaches_the_other_pose(box_figure):
    skeleton = box_figure.skeleton
    a, b = (pose_from_vector(skeleton, jnp.asarray(vector)) for vector in increments(1))
    reached = retract(skeleton, a, difference(skeleton, a, b))
    np.testing.assert_allclose(reached.root, b.root, atol=3e-6)
    np.testing.assert_allclose(reached.angles, b.angles, atol=2e-6)


def test_root_rotation_leaves_the_pelvis_where_it_is(box_figure):
    skeleton = box_figure.skeleton
    pose = pose_from_vector(skeleton, jnp.zeros(39).at[:3].set(jnp.array([30.0, -2.0, 11.0])))
    turned = retract(skeleton, pose, jnp.zeros(39).at[3:6].set(jnp.array([0.3, 1.0, -0.5])))
    np.testing.assert_allclose(pelvis_position(skeleton, turned), pelvis_position(skeleton, pose), atol=1e-5)


def test_clamp_brings_angles_to_the_limits_and_leaves_the_root(box_figure):
    skeleton = box_figure.skeleton
    wild = Pose(root=3 * jnp.eye(4), angles=jnp.full(33, 9.0).at[0].set(-9.0).at[1].set(0.01))
    tame = clamp(skeleton, wild)
    np.testing.assert_array_equal(tame.root, wild.root)
    np.testing.assert_array_equal(tame.angles[2:], skeleton.upper[2:])
    assert tame.angles[0] == skeleton.lower[0]
    assert tame.angles[1] == wild.angles[1]


def test_operations_batch_under_vmap(box_figure):
    skeleton = box_figure.skeleton
    deltas = jnp.asarray(increments(2, 5))
    poses = jax.vmap(lambda delta: retract(skeleton, rest_pose(skeleton), delta))(deltas)
    assert poses.root.shape == (5, 4, 4)
    back = jax.vmap(lambda pose: pose_vector(skeleton, pose))(poses)
    np.testing.assert_allclose(back, deltas, atol=3e-6)
