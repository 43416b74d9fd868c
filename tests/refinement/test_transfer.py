"""Pixels carried over the surface into another picture land where the surface point is drawn there."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxmocap.energies import barycentric_at, rays
from jaxmocap.geometry import facing_cosine
from jaxmocap.observation import full_image_ids
from jaxmocap.refinement import View
from jaxmocap.refinement._transfer import transfer

HERE, THERE = 2, 0


def view_of(world, frame, camera):
    vertices, at = world.vertices(frame), world.cameras.at(frame)
    ids = full_image_ids(world.character, jnp.asarray(vertices), world.cameras, frame)[camera]
    nothing = np.zeros(ids.shape, np.uint8)
    return View(nothing, np.asarray(at.intrinsics[camera]), np.asarray(at.cam_from_world[camera]), vertices, ids)


def everything_near(world):
    count = world.character.faces.shape[0]
    return np.full((count, count // 32 + 1), 0xFFFFFFFF, np.uint32)


def carried(world, view, source, near=None):
    return transfer(np.asarray(world.character.faces), everything_near(world) if near is None else near, view, source)


def pixel_of(source, points):
    local = points @ source.cam_from_world[:3, :3].T + source.cam_from_world[:3, 3]
    homogeneous = local @ source.intrinsics.T
    return homogeneous[:, :2] / homogeneous[:, 2:]


@pytest.mark.parametrize(("frame", "camera"), [(HERE, 1), (THERE, 0), (THERE, 1)])
def test_pixels_land_where_their_surface_point_is_projected(world, frame, camera):
    view, source = view_of(world, HERE, 0), view_of(world, frame, camera)
    source_pixel, seen, _ = carried(world, view, source)
    row, column = np.nonzero(seen)
    assert len(row) > 500
    corners = np.asarray(world.character.faces)[view.ids[row, column]]
    pixels = jnp.asarray(np.stack([column, row], -1) + 0.5, jnp.float32)
    centre, direction, _ = rays(jnp.asarray(view.intrinsics), jnp.asarray(view.cam_from_world), pixels)
    weights = np.asarray(barycentric_at(jnp.asarray(view.vertices[corners]), centre, direction))
    points = np.einsum("rk,rkc->rc", weights, source.vertices[corners])
    apart = np.linalg.norm(source_pixel[row, column] - pixel_of(source, points), axis=1)
    assert np.median(apart) < 1e-3
    assert np.quantile(apart, 0.99) < 0.05  # grazing triangles, whose outer points single precision misplaces


def test_a_view_is_carried_onto_itself(world):
    view = view_of(world, HERE, 1)
    source_pixel, seen, _ = carried(world, view, view)
    row, column = np.nonzero(view.ids >= 0)
    assert seen[row, column].mean() > 0.999  # a pixel centre on an edge may fall on either side
    np.testing.assert_allclose(source_pixel[row, column], np.stack([column, row], -1) + 0.5, atol=1e-3)
    assert not seen[view.ids < 0].any()
    assert (source_pixel[view.ids < 0] == 0).all()


def test_only_the_same_surface_counts_as_seen(world):
    view, source = view_of(world, HERE, 0), view_of(world, HERE, 1)
    count = world.character.faces.shape[0]
    same = np.zeros((count, count // 32 + 1), np.uint32)
    same[np.arange(count), np.arange(count) >> 5] = 1 << (np.arange(count) & 31).astype(np.uint32)
    source_pixel, strictly, _ = carried(world, view, source, same)
    _, loosely, _ = carried(world, view, source)
    assert 0 < strictly.sum() < loosely.sum()
    row, column = np.nonzero(strictly)
    x, y = np.floor(source_pixel[row, column]).astype(int).T
    np.testing.assert_array_equal(source.ids[y, x], view.ids[row, column])


def test_a_window_of_the_source_keeps_its_place(world):
    view, source = view_of(world, HERE, 0), view_of(world, HERE, 1)
    whole = carried(world, view, source)
    top, left = (int(axis.min()) for axis in np.nonzero(source.ids >= 0))
    cut = carried(world, view, source._replace(ids=source.ids[top:, left:], origin=(top, left)))
    for of_cut, of_whole in zip(cut, whole, strict=True):
        np.testing.assert_array_equal(of_cut, of_whole)


def test_what_lies_behind_the_source_is_not_seen(world):
    view = view_of(world, HERE, 0)
    turned = np.diag([-1.0, 1.0, -1.0, 1.0]) @ view.cam_from_world
    source_pixel, seen, _ = carried(world, view, view._replace(cam_from_world=turned))
    assert not seen.any()
    assert np.isfinite(source_pixel).all()


def test_facing_is_one_for_a_triangle_square_to_the_view():
    square = np.array([[[0.0, 0, 2], [0, 1, 2], [1, 0, 2]]]) - np.array([1 / 3, 1 / 3, 0])
    np.testing.assert_allclose(facing_cosine(square), 1.0)
    np.testing.assert_allclose(facing_cosine(square[:, ::-1]), -1.0)
    flat = np.zeros((1, 3, 3))
    assert np.isfinite(facing_cosine(flat)).all()
