"""Rows of Eq. 9: points, rays, residuals and their derivatives."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scoring import FRAME

from jaxmocap.character import retract
from jaxmocap.energies import LineResidual, SurfaceLines, barycentric_at, join_lines, rays, surface_lines
from jaxmocap.render import face_ids


@pytest.fixture(scope="module")
def seen(world):
    """Some pixels of view 0 that see the true body: face, row and column in the rectangle."""
    problem = world.problem(FRAME)
    ids, inverse = face_ids(
        jnp.asarray(world.vertices(FRAME)), world.character.faces, problem.intrinsics, problem.cam_from_world,
        problem.origins, *problem.size,
    )  # fmt: skip
    rows, columns = np.nonzero(np.asarray(ids[0]) >= 0)
    pick = np.random.default_rng(0).choice(len(rows), 60, replace=False)
    rows, columns = rows[pick], columns[pick]
    pixels = np.stack([columns, rows], -1) + np.asarray(problem.origins[0])[::-1] + 0.5
    return np.asarray(ids[0])[rows, columns], pixels.astype(np.float32), np.asarray(inverse[0])[rows, columns]


def lines_to(world, seen, targets, weight=None, target_view=None):
    problem = world.problem(FRAME)
    view = lambda c: (problem.intrinsics[c], problem.cam_from_world[c])  # noqa: E731
    return surface_lines(
        jnp.asarray(world.vertices(FRAME)), world.character.faces, jnp.asarray(seen[0]), jnp.asarray(seen[1]),
        jnp.asarray(targets, jnp.float32), jnp.ones(len(targets)) if weight is None else jnp.asarray(weight), view(0),
        None if target_view is None else view(target_view),
    )  # fmt: skip


def distance_to_ray(problem, camera, pixels, points):
    """Metres between points and the rays of pixels, in double precision."""
    pose = np.asarray(problem.cam_from_world[camera], np.float64)
    centre = -pose[:3, :3].T @ pose[:3, 3]
    inverse = np.linalg.inv(np.asarray(problem.intrinsics[camera], np.float64))
    direction = np.c_[pixels, np.ones(len(pixels))] @ inverse.T @ pose[:3, :3]
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    offset = points - centre
    return np.linalg.norm(offset - (offset * direction).sum(1, keepdims=True) * direction, axis=1)


def test_points_are_on_the_surface_where_the_pixels_see_it(world, seen):
    lines, problem = lines_to(world, seen, seen[1]), world.problem(FRAME)
    points = np.asarray(lines.points(jnp.asarray(world.vertices(FRAME))), np.float64)
    pose = np.asarray(problem.cam_from_world[0], np.float64)
    np.testing.assert_allclose(1 / (points @ pose[2, :3] + pose[2, 3]), seen[2], atol=2e-4)
    np.testing.assert_array_equal(lines.corners, np.asarray(world.character.faces)[seen[0]])
    np.testing.assert_allclose(np.asarray(lines.barycentric).sum(1), 1, atol=1e-5)


def test_residual_is_zero_on_the_own_pixel(world, seen):
    residual = np.asarray(lines_to(world, seen, seen[1]).residual(jnp.asarray(world.vertices(FRAME))))
    assert np.linalg.norm(residual, axis=1).max() < 6e-5


@pytest.mark.parametrize("target_view", [0, 1])
def test_residual_is_the_distance_of_point_and_ray(world, seen, target_view):
    targets = seen[1] + np.random.default_rng(1).normal(size=seen[1].shape) * 6
    lines = lines_to(world, seen, targets, target_view=target_view)
    vertices = jnp.asarray(world.vertices(FRAME))
    points = np.asarray(lines.points(vertices), np.float64)
    expected = distance_to_ray(world.problem(FRAME), target_view, targets, points)
    assert expected.mean() > 0.01
    np.testing.assert_allclose(np.linalg.norm(lines.residual(vertices), axis=1), expected, atol=2e-5)


def test_a_point_seen_in_one_view_lies_on_its_ray_in_the_other(world, seen):
    """Targets are the projections of the points into the other view."""
    problem = world.problem(FRAME)
    vertices = jnp.asarray(world.vertices(FRAME))
    points = np.asarray(lines_to(world, seen, seen[1]).points(vertices), np.float64)
    there = np.c_[points, np.ones(len(points))] @ np.asarray(problem.projection[1], np.float64).T
    lines = lines_to(world, seen, there[:, :2] / there[:, 2:], target_view=1)
    assert np.linalg.norm(lines.residual(vertices), axis=1).max() < 5e-5


def test_lines_have_unit_directions_and_moments_of_the_centre(world, seen):
    problem = world.problem(FRAME)
    centre, direction, moment = rays(problem.intrinsics[1], problem.cam_from_world[1], jnp.asarray(seen[1]))
    np.testing.assert_allclose(np.linalg.norm(direction, axis=1), 1, atol=1e-6)
    np.testing.assert_allclose(moment, np.cross(centre, direction), atol=1e-6)
    np.testing.assert_allclose(centre, np.asarray(world.cameras.centres())[1, FRAME], atol=1e-5)


def test_barycentric_coordinates_of_a_known_ray():
    triangle = jnp.array([[[0.0, 0, 2], [1, 0, 2], [0, 1, 2]]] * 2)
    directions = jnp.array([[0.1, 0.2, 1.0], [-3.0, 0.5, 1.0]])
    found = barycentric_at(triangle, jnp.zeros(3), directions)
    np.testing.assert_allclose(found[0], [0.4, 0.2, 0.4], atol=1e-6)
    np.testing.assert_allclose(found[1].sum(), 1, atol=1e-6)
    assert np.all((found >= 0) & (found <= 1))


def test_joined_lines_are_all_rows_in_order(world, seen):
    first, second = lines_to(world, seen, seen[1]), lines_to(world, seen, seen[1] + 1)
    joined = join_lines(first, second)
    np.testing.assert_array_equal(joined.moment, np.concatenate([first.moment, second.moment]))
    np.testing.assert_array_equal(joined.corners, np.concatenate([first.corners, second.corners]))
    assert joined.weight.shape == (120,)


def double(tree):
    return jax.tree.map(
        lambda leaf: jnp.asarray(np.asarray(leaf), jnp.float64) if leaf.dtype.kind == "f" else leaf, tree
    )


value = eqx.filter_jit(lambda residual, delta: residual(delta))
derivative = eqx.filter_jit(lambda residual, delta: jax.jacfwd(residual)(delta))


def residual_of(world, lines, robust):
    count = lines.weight.shape
    return LineResidual(world.character, world.pose(FRAME), lines, jnp.full(count, 0.02), jnp.full(count, robust))


@pytest.mark.parametrize("robust", [0.03, np.inf])
def test_derivative_equals_central_differences(world, seen, robust):
    weight = np.linspace(0, 1, 60, dtype=np.float32)
    targets = seen[1] + np.random.default_rng(2).normal(size=seen[1].shape) * 3
    single = residual_of(world, lines_to(world, seen, targets, weight), robust)
    with jax.enable_x64(True):
        residual = double(single)
        at = jnp.asarray(np.random.default_rng(3).normal(size=39) * 0.02)
        jacobian = np.asarray(derivative(residual, at))
        step = 1e-5
        numeric = [(value(residual, at + e) - value(residual, at - e)) / (2 * step) for e in step * jnp.eye(39)]
        np.testing.assert_allclose(jacobian, np.stack(numeric, 1), atol=2e-6 * np.abs(jacobian).max())
        assert np.abs(jacobian).max() > 1


def test_residual_is_the_geman_mcclure_cost(world, seen):
    targets = seen[1] + np.random.default_rng(4).normal(size=seen[1].shape) * 8
    weight = np.random.default_rng(5).uniform(size=60).astype(np.float32)
    lines = lines_to(world, seen, targets, weight)
    distance = np.linalg.norm(lines.residual(jnp.asarray(world.vertices(FRAME))), axis=1)
    for robust, cost in ((0.03, 0.03**2 * distance**2 / (0.03**2 + distance**2)), (np.inf, distance**2)):
        rows = np.asarray(residual_of(world, lines, robust)(jnp.zeros(39))).reshape(60, 3)
        np.testing.assert_allclose((rows**2).sum(1), weight * cost / 0.02**2, rtol=2e-3, atol=1e-6)


def test_rows_switched_off_are_zero_and_have_zero_derivatives(world, seen):
    """Also rows that see no face, and rows whose numbers are arbitrary."""
    ids = np.where(np.arange(60) < 20, -1, seen[0])
    weight = np.where(np.arange(60) < 20, 1.0, np.where(np.arange(60) < 40, 0.0, 1.0))
    targets = np.where(np.arange(60)[:, None] < 40, 0.0, seen[1] + 2)
    lines = lines_to(world, (ids, seen[1]), targets, weight.astype(np.float32))
    np.testing.assert_array_equal(lines.weight, (np.arange(60) >= 40).astype(np.float32))
    for robust in (0.03, np.inf):
        residual = residual_of(world, lines, robust)
        rows, jacobian = value(residual, jnp.zeros(39)), derivative(residual, jnp.zeros(39))
        assert np.all(np.isfinite(rows))
        assert np.all(np.isfinite(jacobian))
        np.testing.assert_array_equal(rows[:120], 0)
        np.testing.assert_array_equal(jacobian[:120], 0)
        assert np.all(np.abs(np.asarray(jacobian[120:]).reshape(20, 3, 39)).max((1, 2)) > 0)


def test_degenerate_rows_of_weight_zero_stay_finite(world):
    """What fills up a list of rows: a triangle without area, a line without direction, a residual of exactly 0."""
    direction = jnp.zeros((60, 3)).at[30:, 2].set(1.0)
    lines = SurfaceLines(
        jnp.zeros((60, 3), jnp.int32), jnp.zeros((60, 3)), direction, jnp.zeros((60, 3)), jnp.zeros(60)
    )
    flat = barycentric_at(jnp.ones((1, 3, 3)), jnp.zeros(3), jnp.array([[0.0, 0.0, 1.0]]))
    assert np.all(np.isfinite(flat))
    residual = residual_of(world, lines, 0.03)
    assert np.all(np.isfinite(derivative(residual, jnp.zeros(39))))


def test_moving_the_body_sideways_moves_every_residual_by_as_much_across_the_ray(world, seen):
    lines = lines_to(world, seen, seen[1])
    delta = np.zeros(39, np.float32)
    delta[0] = 0.03
    pose = retract(world.character.skeleton, world.pose(FRAME), jnp.asarray(delta))
    found = np.linalg.norm(lines.at(world.character, pose), axis=1)
    along = np.asarray(lines.direction)[:, 0]
    np.testing.assert_allclose(found, 0.03 * np.sqrt(1 - along**2), atol=3e-5)
