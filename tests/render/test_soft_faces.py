"""The soft rasteriser: shares of pixels against areas counted point by point, and against the hard rasteriser."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from meshes import INTRINSICS, camera_at, sphere

from jaxmocap.render import (
    SoftSettings,
    covered_area,
    face_ids,
    inverse_depth_range,
    projection_matrices,
    soft_faces,
    to_screen,
)

HEIGHT, WIDTH = 180, 200
ORIGIN = jnp.array([150, 150], jnp.int32)
POSE = jnp.asarray(camera_at(2.6), jnp.float32)
PROJECTION = projection_matrices(jnp.asarray(INTRINSICS, jnp.float32), POSE)
drawn = eqx.filter_jit(soft_faces)


def seen(vertices, faces, **settings):
    vertices = jnp.asarray(vertices, jnp.float32)
    depths = inverse_depth_range(vertices, POSE)
    screen = to_screen(vertices, PROJECTION, ORIGIN)
    return drawn(screen, jnp.asarray(faces.T, jnp.int32), HEIGHT, WIDTH, depths, SoftSettings(**settings))


def coverage(view):
    """The covered part of every pixel."""
    total = np.zeros(HEIGHT * WIDTH)
    live = np.asarray(view.live) > 0
    total[np.asarray(view.pixel)[live]] = np.asarray(view.share).sum(1)[live]
    return total.reshape(HEIGHT, WIDTH)


@pytest.mark.parametrize("width", [0.5, 1.0, 2.0])
def test_the_area_of_a_triangle_in_a_square_is_that_of_points_inside_both(width):
    corners = np.random.default_rng(0).normal(0, 0.8, (2, 3, 100)).astype(np.float32)
    grid = ((np.arange(500) + 0.5) / 500 - 0.5) * width
    x, y = np.meshgrid(grid, grid)
    area = np.asarray(covered_area(jnp.asarray(corners[0]), jnp.asarray(corners[1]), width))
    for index in range(100):
        (ax, bx, cx), (ay, by, cy) = corners[:, :, index]
        sides = [(q - p) * (y - s) - (r - s) * (x - p) for p, q, s, r in
                 ((ax, bx, ay, by), (bx, cx, by, cy), (cx, ax, cy, ay))]  # fmt: skip
        inside = np.all(np.array(sides) >= 0, 0) | np.all(np.array(sides) <= 0, 0)
        assert abs(inside.mean() - area[index]) < 2e-3


def test_the_derivative_of_the_area_is_its_difference_quotient():
    corners = np.random.default_rng(1).normal(0, 0.7, (6, 60))
    with jax.enable_x64(True):
        value = jax.jit(lambda c: covered_area(c[:3], c[3:], 1.0).sum())
        slope = np.asarray(jax.grad(value)(jnp.asarray(corners)))
        for row, column in np.ndindex(corners.shape):
            step = np.zeros_like(corners)
            step[row, column] = 1e-6
            quotient = (value(jnp.asarray(corners + step)) - value(jnp.asarray(corners - step))) / 2e-6
            assert slope[row, column] == pytest.approx(float(quotient), abs=2e-3)


@pytest.mark.slow
def test_faces_of_one_surface_share_its_pixels_without_a_gap():
    vertices, faces = sphere()
    view = seen(vertices, faces)
    ids, _ = face_ids(vertices, faces, INTRINSICS[None], POSE[None], ORIGIN[None], HEIGHT, WIDTH)
    solid = np.asarray(ids[0]) >= 0
    inner = solid.copy()
    for axis in (0, 1):
        for shift in (-2, -1, 1, 2):
            inner &= np.roll(solid, shift, axis)
    total = coverage(view)
    assert inner.sum() > 5000
    np.testing.assert_allclose(total[inner], 1.0, atol=1e-4)
    assert total.max() < 1 + 1e-4
    assert np.all(total[~(np.asarray(view.slot) < 65536).reshape(HEIGHT, WIDTH)] == 0)
    assert total.sum() == pytest.approx(solid.sum(), rel=2e-3)


def test_a_near_face_hides_its_share_of_what_lies_behind():
    square = np.array([[-0.3, -0.3, 0], [0.3, -0.3, 0], [0.3, 0.3, 0], [-0.3, 0.3, 0]])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    toward = np.array([np.sin(0.3), 0.1, np.cos(0.3)]) * 0.4
    both = np.concatenate([square, square * [0.4, 0.4, 1] + toward])
    view = seen(both, np.concatenate([faces, faces + 4]))
    alone = seen(both, faces + 4)
    share, number = np.asarray(view.share), np.asarray(view.face)
    front = np.where(number >= 2, share, 0).sum()
    assert front == pytest.approx(coverage(alone).sum(), rel=1e-4)
    np.testing.assert_allclose(coverage(view), coverage(seen(both, faces)), atol=1e-3)


def test_without_width_it_is_the_hard_rasteriser(dancers, actor):
    vertices, faces = dancers[1], np.asarray(actor.faces)
    ids, inverse = face_ids(vertices, faces, INTRINSICS[None], POSE[None], ORIGIN[None], HEIGHT, WIDTH)
    ids, inverse = np.asarray(ids[0]).reshape(-1), np.asarray(inverse[0]).reshape(-1)
    view = seen(vertices, faces, width=1e-3)
    live = np.asarray(view.live) > 0
    most = np.asarray(view.share).argmax(1)
    found = np.full(HEIGHT * WIDTH, -1)
    rows = np.arange(len(most))
    found[np.asarray(view.pixel)[live]] = np.where(
        np.asarray(view.share)[rows, most] > 0.5, np.asarray(view.face)[rows, most], -1
    )[live]
    assert (ids >= 0).sum() > 3000
    assert (found != ids).mean() < 1e-3
    same = live & (found[np.asarray(view.pixel)] == ids[np.asarray(view.pixel)]) & (ids[np.asarray(view.pixel)] >= 0)
    depth = np.asarray(view.inverse_depth)[rows, most]
    np.testing.assert_allclose(depth[same], inverse[np.asarray(view.pixel)][same], rtol=1e-4)


@pytest.mark.slow
def test_what_does_not_fit_is_counted():
    vertices, faces = sphere()
    whole = np.asarray(seen(vertices, faces).needed)
    small = seen(vertices, faces, windows=64, pixels=512, shares=512)
    assert whole[0] > 64
    assert int(small.needed[0]) == whole[0]
    cut = seen(vertices, faces, pixels=512, shares=512)
    assert int(cut.needed[1]) == whole[1]
    assert int(cut.needed[1]) > 512


def test_shares_follow_every_vertex_of_the_outline():
    """The covered area of a face alone is its projected area: the derivative is known."""
    corners = np.array([[-0.21, -0.17, 0.0], [0.24, -0.11, 0.05], [0.02, 0.27, -0.04]])
    faces = np.array([[0, 1, 2]])

    def covered(points):
        depths = inverse_depth_range(points, POSE, 0.1)
        view = drawn(to_screen(points, PROJECTION, ORIGIN), jnp.asarray(faces.T), HEIGHT, WIDTH, depths)
        return view.share.sum()

    def area(points):
        x, y, _ = to_screen(points, PROJECTION, ORIGIN)
        return 0.5 * jnp.abs((x[1] - x[0]) * (y[2] - y[0]) - (y[1] - y[0]) * (x[2] - x[0]))

    points = jnp.asarray(corners, jnp.float32)
    (value, slope), (expected, along) = (jax.value_and_grad(each)(points) for each in (covered, area))
    assert float(value) == pytest.approx(float(expected), rel=1e-4)
    np.testing.assert_allclose(slope, along, rtol=2e-3, atol=2.0)
