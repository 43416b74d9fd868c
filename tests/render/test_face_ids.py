"""Face numbers and inverse depth against a z-buffer in double precision."""

import jax.numpy as jnp
import numpy as np
import pytest
from meshes import INTRINSICS, camera_at, sphere, z_buffer

from jaxmocap.render import KeyLayout, face_ids, inverse_depth_range

HEIGHT, WIDTH = 480, 496
ORIGIN = (8, 4)


def drawn(vertices, faces, cameras, origins=None, height=HEIGHT, width=WIDTH, intrinsics=INTRINSICS):
    cameras = np.stack(cameras).astype(np.float32)
    count = len(cameras)
    origins = np.tile(ORIGIN, (count, 1)) if origins is None else np.asarray(origins)
    ids, inverse = face_ids(
        jnp.asarray(vertices, jnp.float32),
        jnp.asarray(faces, jnp.int32),
        jnp.asarray(np.tile(intrinsics, (count, 1, 1)), jnp.float32),
        jnp.asarray(cameras),
        jnp.asarray(origins, jnp.int32),
        height,
        width,
    )
    return np.asarray(ids), np.asarray(inverse)


CAMERAS = [camera_at(2.6, -0.25), camera_at(2.9, 0.25, 0.2)]


@pytest.fixture(scope="module")
def compared(actor, dancers):
    """(ids, inverse depth) here and in double precision, for every pose and view."""
    pairs = []
    for vertices in dancers:
        ids, inverse = drawn(vertices, actor.faces, CAMERAS)
        for view, camera in enumerate(CAMERAS):
            expected = z_buffer(vertices, actor.faces, INTRINSICS, camera.astype(np.float32), ORIGIN, HEIGHT, WIDTH)
            pairs.append(((ids[view], inverse[view]), expected))
    return pairs


def test_faces_are_those_of_the_z_buffer_in_all_but_2_of_10000_covered_pixels(compared):
    wrong = sum((found[0] != expected[0]).sum() for found, expected in compared)
    covered = sum((expected[0] >= 0).sum() for _, expected in compared)
    assert covered > 150_000
    assert wrong <= 2e-4 * covered


def test_silhouettes_are_those_of_the_z_buffer_to_a_pixel_per_view(compared):
    for (ids, _), (expected, _) in compared:
        assert ((ids >= 0) != (expected >= 0)).sum() <= 1


def test_inverse_depth_is_accurate_to_a_hundred_thousandth(compared):
    for (ids, inverse), (expected_ids, expected) in compared:
        same = (ids == expected_ids) & (ids >= 0)
        np.testing.assert_allclose(inverse[same], expected[same], atol=1e-5)
        assert np.all(inverse[ids < 0] == 0)


def test_rectangle_is_the_crop_of_a_larger_picture(actor, dancers):
    """Also where the rectangle cuts through the body, beginning at odd pixels."""
    whole, whole_depth = drawn(dancers[1], actor.faces, CAMERAS)
    origins = [(8 + 153, 4 + 171), (8 + 90, 4 + 203)]
    part, part_depth = drawn(dancers[1], actor.faces, CAMERAS, origins, 150, 120)
    for view, (row, column) in enumerate(origins):
        window = slice(row - ORIGIN[0], row - ORIGIN[0] + 150), slice(column - ORIGIN[1], column - ORIGIN[1] + 120)
        same = part[view] == whole[view][window]
        assert (~same).sum() <= 2  # the pixel's coordinates are rounded at another place
        np.testing.assert_allclose(part_depth[view][same], whole_depth[view][window][same], atol=2e-6)
    assert (part[0, 0] >= 0).any()
    assert (part[0, :, 0] >= 0).any() or (part[1, :, 0] >= 0).any()


def test_empty_picture():
    vertices, faces = sphere()
    ids, inverse = drawn(vertices + [30.0, 0, 0], faces, CAMERAS)
    assert np.all(ids == -1)
    assert np.all(inverse == 0)


def test_faces_behind_the_camera_are_dropped():
    vertices, faces = sphere()
    eye = camera_at(2.0, 0.0, 0.0)
    behind = vertices + [0, 0, 4.0]
    ids, _ = drawn(behind, faces, [eye])
    assert np.all(ids == -1)
    both = np.concatenate([vertices, behind])
    ids, _ = drawn(both, np.concatenate([faces, faces + len(vertices)]), [eye])
    alone, _ = drawn(vertices, faces, [eye])
    np.testing.assert_array_equal(ids, alone)


def test_a_face_that_reaches_behind_the_camera_is_dropped():
    eye = camera_at(2.0, 0.0, 0.0)
    corners = np.array([[-0.3, -0.3, 0.0], [0.3, -0.3, 0.0], [0.0, 0.3, 0.0]])
    ids, _ = drawn(corners, np.array([[0, 1, 2]]), [eye])
    assert (ids == 0).any()
    reaching = corners.copy()
    reaching[2, 2] = 3.0
    ids, _ = drawn(reaching, np.array([[0, 1, 2]]), [eye])
    assert np.all(ids == -1)


def test_faces_turned_away_are_dropped():
    eye = camera_at(2.0, 0.0, 0.0)
    corners = np.array([[-0.3, -0.3, 0.0], [0.3, -0.3, 0.0], [0.0, 0.3, 0.0]])
    ids, _ = drawn(corners, np.array([[0, 2, 1]]), [eye])
    assert np.all(ids == -1)


def test_more_windows_than_the_first_capacity_are_drawn_after_all():
    """Two faces over the whole picture need more than the 4,096 windows that are tried first."""
    corners = np.array([[-5.0, -5.0, 0.0], [5.0, -5.0, 0.0], [5.0, 5.0, 0.0], [-5.0, 5.0, 0.0]])
    ids, inverse = drawn(corners, np.array([[0, 1, 2], [0, 2, 3]]), [camera_at(2.0, 0.0, 0.0)], [(0, 0)], 600, 640)
    assert set(np.unique(ids)) == {0, 1}
    np.testing.assert_allclose(inverse, 0.5, atol=1e-5)


@pytest.mark.parametrize("faces", [1, 14, 15, 16, 4932, 500_000])
def test_keys_hold_a_face_and_a_depth(faces):
    layout = KeyLayout.for_faces(faces)
    depth_range = jnp.array([0.2, 0.5])
    numbers = np.unique(np.linspace(0, faces - 1, 50).astype(np.int64))
    levels = np.linspace(1, layout.depth_levels + 1, len(numbers)).astype(np.int64)
    keys = (levels << layout.id_bits) | numbers
    assert keys.max() < 2**31
    assert keys.min() > layout.empty
    keys = jnp.asarray(keys, jnp.int32)
    np.testing.assert_array_equal(layout.face(keys), numbers)
    expected = 0.2 + 0.3 * (levels - 1) / layout.depth_levels
    np.testing.assert_allclose(layout.inverse_depth(keys, depth_range), expected, atol=1e-6)
    assert int(layout.face(jnp.asarray(layout.empty))) == -1


def test_a_nearer_depth_has_the_larger_key_whatever_the_face():
    layout = KeyLayout.for_faces(5000)
    assert (7 << layout.id_bits) | 0 > (6 << layout.id_bits) | 4999


def test_too_many_faces_for_the_keys_are_refused():
    with pytest.raises(ValueError, match="simplify the mesh"):
        KeyLayout.for_faces(600_000)


def test_depth_range_holds_the_body_with_its_slack(dancers):
    low, high = np.asarray(inverse_depth_range(jnp.asarray(dancers[0]), jnp.asarray(CAMERAS[0], jnp.float32), 0.5))
    depth = dancers[0] @ CAMERAS[0][2, :3] + CAMERAS[0][2, 3]
    np.testing.assert_allclose([1 / high, 1 / low], [depth.min() - 0.501, depth.max() + 0.501], atol=1e-4)
