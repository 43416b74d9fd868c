"""Eqs 1, 2 and 4: known values, the adjoint Jacobian against automatic differentiation, the Taylor error's order."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmocap.character import (
    Pose,
    blend,
    body_transforms,
    build_skeleton,
    landmark_positions,
    points_and_jacobian,
    pose_from_vector,
    rest_pose,
    retract,
    skin,
)
from jaxmocap.character._kinematics import _steps, chain


def some_pose(skeleton, seed: int = 0, size: float = 0.5):
    vector = np.random.default_rng(seed).normal(0, size, 39)
    return pose_from_vector(skeleton, jnp.asarray(vector, skeleton.axes.dtype))


def at_precision(character, dtype):
    """The character's arrays in another precision, with axes of exactly unit length there."""
    cast = jax.tree.map(lambda x: x.astype(dtype) if jnp.issubdtype(x.dtype, jnp.floating) else x, character)
    axes = cast.skeleton.axes / jnp.linalg.norm(cast.skeleton.axes, axis=1, keepdims=True)
    return jax.tree.map(lambda x: axes if x is cast.skeleton.axes else x, cast)


def test_bodies_stand_at_the_identity_in_the_rest_pose(box_figure):
    transforms = body_transforms(box_figure.skeleton, rest_pose(box_figure.skeleton))
    np.testing.assert_array_equal(transforms, np.tile(np.eye(4, dtype=np.float32), (18, 1, 1)))
    vertices = skin(box_figure, rest_pose(box_figure.skeleton))
    np.testing.assert_allclose(vertices, box_figure.vertices, atol=2e-7)


def test_body_transforms_equal_the_product_of_matrix_exponentials(box_figure):
    from scipy.linalg import expm

    skeleton = box_figure.skeleton
    pose = some_pose(skeleton)
    axes, origins = np.asarray(skeleton.axes, float), np.asarray(skeleton.origins, float)
    expected = []
    for body in range(18):
        path = [body]
        while skeleton.parents[path[-1]] >= 0:
            path.append(skeleton.parents[path[-1]])
        transform = np.asarray(pose.root, float)
        for ancestor in reversed(path):
            for dof in [d for d, owner in enumerate(skeleton.dof_body) if owner == ancestor]:
                x, y, z = axes[dof]
                twist = np.zeros((4, 4))
                twist[:3, :3] = [[0, -z, y], [z, 0, -x], [-y, x, 0]]
                twist[:3, 3] = -np.cross(axes[dof], origins[dof])
                transform = transform @ expm(float(pose.angles[dof]) * twist)
        expected.append(transform)
    np.testing.assert_allclose(body_transforms(skeleton, pose), expected, atol=3e-6)


@pytest.mark.parametrize("name", ["box_figure", "actor"])
def test_skin_equals_a_plain_loop(request, name):
    character = request.getfixturevalue(name)
    pose = some_pose(character.skeleton)
    transforms = np.asarray(body_transforms(character.skeleton, pose), float)
    vertices, weights = np.asarray(character.vertices, float), np.asarray(character.weights, float)
    expected = np.zeros_like(vertices)
    for v in range(len(vertices)):
        for b in range(18):
            expected[v] += weights[v, b] * (transforms[b, :3, :3] @ vertices[v] + transforms[b, :3, 3])
    np.testing.assert_allclose(skin(character, pose), expected, atol=5e-6)


def test_landmarks_move_with_their_bodies(box_figure):
    skeleton = box_figure.skeleton
    pose = some_pose(skeleton)
    expected = blend(skeleton, pose, skeleton.landmarks, jnp.eye(18)[jnp.array(skeleton.landmark_bodies)])
    np.testing.assert_allclose(landmark_positions(skeleton, pose), expected, atol=2e-6)


@pytest.mark.parametrize(("dtype", "tolerance"), [("float32", 1e-5), ("float64", 1e-12)])
@pytest.mark.parametrize("size", [0.0, 0.5])
def test_adjoint_jacobian_equals_automatic_differentiation(box_figure, dtype, tolerance, size):
    with jax.enable_x64(dtype == "float64"):
        character = at_precision(box_figure, dtype)
        rng = np.random.default_rng(3)
        points = jnp.asarray(character.vertices[::4])
        weights = jnp.asarray(rng.dirichlet(np.full(18, 0.3), len(points)), dtype)
        skeleton = character.skeleton
        pose = some_pose(skeleton, size=size)
        moved = lambda delta: blend(skeleton, retract(skeleton, pose, delta), points, weights)  # noqa: E731
        expected = jax.jit(jax.jacfwd(moved))(jnp.zeros(39, dtype))
        positions, jacobian = jax.jit(points_and_jacobian)(skeleton, pose, points, weights)
        np.testing.assert_allclose(positions, moved(jnp.zeros(39, dtype)), atol=tolerance)
        np.testing.assert_allclose(jacobian, expected, atol=tolerance)
        assert jacobian.shape == (len(points), 3, 39)


def test_wrist7_moves_hands_about_the_wrist_and_its_jacobian_is_right(box_figure):
    names = box_figure.skeleton.landmark_names
    joints = dict(zip(names, np.asarray(box_figure.skeleton.landmarks), strict=True))
    skeleton = build_skeleton(joints, arm="wrist7")
    pose = some_pose(skeleton)
    points, weights = box_figure.vertices[::8], box_figure.weights[::8]
    moved = lambda delta: blend(skeleton, retract(skeleton, pose, delta), points, weights)  # noqa: E731
    _, jacobian = points_and_jacobian(skeleton, pose, points, weights)
    np.testing.assert_allclose(jacobian, jax.jit(jax.jacfwd(moved))(jnp.zeros(39)), atol=1e-5)
    flex = skeleton.dof_names.index("l_wrist_flex")
    palms = rest_pose(skeleton).angles.at[flex - 6].set(jnp.pi / 3)
    before, after = (landmark_positions(skeleton, Pose(jnp.eye(4), angles)) for angles in (0 * palms, palms))
    np.testing.assert_allclose(after, before, atol=1e-6)  # no landmark lies beyond the wrist
    hand = body_transforms(skeleton, Pose(jnp.eye(4), palms))[skeleton.body_names.index("l_hand")]
    tip = jnp.asarray(joints["l_wrist"]) + jnp.array([0.1, 0.0, 0.0])
    np.testing.assert_allclose(
        np.asarray(hand[:3, :3]) @ np.asarray(tip) + hand[:3, 3] - tip, [-0.05, -0.0866, 0.0], atol=1e-4
    )


def test_jacobian_equals_finite_differences(box_figure):
    with jax.enable_x64():
        character = at_precision(box_figure, "float64")
        skeleton, pose = character.skeleton, some_pose(character.skeleton)
        points, weights = character.vertices[::16], character.weights[::16]
        _, jacobian = points_and_jacobian(skeleton, pose, points, weights)
        place = jax.jit(lambda delta: blend(skeleton, retract(skeleton, pose, delta), points, weights))
        for dof in range(39):
            step = jnp.zeros(39).at[dof].set(1e-6)
            np.testing.assert_allclose((place(step) - place(-step)) / 2e-6, jacobian[:, :, dof], atol=1e-8)


def test_gradients_are_finite_and_right_in_the_rest_pose(box_figure):
    skeleton = box_figure.skeleton
    pose = rest_pose(skeleton)
    target = jnp.asarray(np.random.default_rng(7).normal(0, 0.1, box_figure.vertices.shape), jnp.float32)
    loss = lambda delta: jnp.sum(target * skin(box_figure, retract(skeleton, pose, delta)))  # noqa: E731
    reverse = jax.jit(jax.grad(loss))(jnp.zeros(39))
    _, jacobian = points_and_jacobian(skeleton, pose, box_figure.vertices, box_figure.weights)
    np.testing.assert_allclose(reverse, np.einsum("vi,vid->d", target, jacobian), atol=1e-4)
    along = jnp.asarray(np.random.default_rng(8).normal(size=39), jnp.float32)
    second = jax.jit(lambda x: jax.jvp(jax.grad(loss), (x,), (along,))[1])(jnp.zeros(39))
    assert np.all(np.isfinite(second))


def test_gradients_reach_the_skeleton_itself(box_figure):
    pose = some_pose(box_figure.skeleton)
    gradient = jax.grad(lambda s: jnp.sum(body_transforms(s, pose)[:, :3, 3] ** 2), allow_int=True)(box_figure.skeleton)
    assert np.all(np.isfinite(gradient.origins))
    assert np.any(np.asarray(gradient.origins) != 0)


def test_a_batch_of_poses_is_the_poses_one_by_one(box_figure):
    skeleton = box_figure.skeleton
    deltas = jnp.asarray(np.random.default_rng(9).normal(0, 0.4, (6, 39)), jnp.float32)
    one = lambda delta: skin(box_figure, retract(skeleton, rest_pose(skeleton), delta))  # noqa: E731
    batch = jax.jit(jax.vmap(one))(deltas)
    np.testing.assert_allclose(batch, jnp.stack([one(delta) for delta in deltas]), atol=3e-6)


@pytest.mark.parametrize("trunk_alone", [False, True])
def test_joints_that_move_side_by_side_end_where_they_do_one_by_one(box_figure, monkeypatch, trunk_alone):
    """An accelerator poses the joints of a level in one step; a body without any joint follows its parent."""
    skeleton = box_figure.skeleton
    if trunk_alone:
        skeleton = replace(skeleton, dof_body=tuple(min(body, 3) for body in skeleton.dof_body))
    pose = some_pose(skeleton)
    alone = chain(skeleton, pose)
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    together = chain(skeleton, pose)
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, atol=2e-6), together, alone)
    assert _steps(skeleton.parents, skeleton.dof_body, side_by_side=True).dof.ndim == 2
