"""Colours of a scanned surface: a ball whose colour is known everywhere."""

import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from test_scan import RADIUS, SIZE, ring, seen

from jaxmocap.character import Character, Document
from jaxmocap.rigging import body
from jaxmocap.scan import Views, vertex_colours


def colour_at(points: np.ndarray) -> np.ndarray:
    """Smooth over the ball, RGB 0 to 255."""
    return 127.5 + 120 * np.sin(points / RADIUS * [1.0, 1.5, 2.0] + [0.0, 0.5, 1.0])


def painted(count: int) -> Views:
    """Views of the ball in its colours; pictures of half the size, as scans of large pictures have them."""
    views = seen(*ring(count))
    row, column = np.mgrid[: SIZE // 2, : SIZE // 2]
    pixel = np.stack([2 * column + 1.0, 2 * row + 1.0, np.ones(row.shape)], -1)
    pictures = []
    for k, pose in zip(views.intrinsics, views.cam_from_world, strict=True):
        rays = pixel @ np.linalg.inv(k).T @ pose[:3, :3]
        rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
        centre = -pose[:3, :3].T @ pose[:3, 3]
        towards = -rays @ centre
        room = np.maximum(towards**2 - (centre @ centre) + RADIUS**2, 0.0)
        pictures.append(colour_at(centre + rays * (towards - np.sqrt(room))[..., None]))
    return views._replace(pictures=np.clip(np.stack(pictures), 0, 255).astype(np.uint8))


@pytest.fixture(scope="module")
def ball() -> trimesh.Trimesh:
    return trimesh.creation.icosphere(subdivisions=3, radius=RADIUS)


def test_vertices_have_the_colours_of_their_places(ball):
    found = vertex_colours(ball.vertices, ball.faces, painted(8))
    error = np.abs(found - colour_at(ball.vertices)).max(1)
    around = np.abs(ball.vertices[:, 1]) < 0.6 * RADIUS
    assert error[around].max() < 6


def test_what_no_view_sees_goes_with_its_neighbours(ball):
    """No camera of the ring sees the poles."""
    found = vertex_colours(ball.vertices, ball.faces, painted(8)).astype(float)
    up = ball.vertices[:, 1] / RADIUS
    pole, rim = found[up > 0.99], found[(up > 0.85) & (up < 0.95)]
    assert len(pole) > 0
    assert np.abs(pole - rim.mean(0)).max() < 40
    assert np.abs(pole - colour_at(ball.vertices[up > 0.99])).max() < 40


def test_where_several_pictures_show_a_place_a_wrong_one_changes_nothing(ball):
    """Somebody stands before the person in one of twelve: black there."""
    views = painted(12)
    spoilt = views.pictures.copy()
    spoilt[2] = 0
    each = (views.pictures, spoilt)
    before, after = (vertex_colours(ball.vertices, ball.faces, views._replace(pictures=p)).astype(int) for p in each)
    around = np.abs(ball.vertices[:, 1]) < 0.6 * RADIUS
    assert np.abs(before - after)[around].max() < 6


def test_what_lies_behind_the_surface_is_not_seen(ball):
    """The hidden side of the ball keeps the colours of its own views, though it projects into all pictures."""
    two = painted(8).only(np.isin(np.arange(8), (0, 4)))
    found = vertex_colours(ball.vertices, ball.faces, two)
    facing = np.abs(ball.vertices[:, 0]) > 0.6 * RADIUS
    assert np.abs(found - colour_at(ball.vertices))[facing].max() < 6


def test_colours_are_written_and_change_nothing_else(tmp_path):
    character = body(1.7)
    colours = np.random.default_rng(0).integers(0, 256, (len(character.vertices), 3)).astype(np.uint8)
    plain, coloured = character.save_glb(tmp_path / "a.glb"), character.save_glb(tmp_path / "b.glb", colours)
    a, b = Character.load(plain), Character.load(coloured)
    np.testing.assert_array_equal(a.vertices, b.vertices)
    np.testing.assert_array_equal(a.weights, b.weights)
    document = Document(coloured)
    primitive = document.content["meshes"][0]["primitives"][0]
    linear = document.array(primitive["attributes"]["COLOR_0"])
    srgb = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    np.testing.assert_allclose(255 * srgb, colours, atol=0.01)
    assert document.content["materials"][primitive["material"]]["pbrMetallicRoughness"]["metallicFactor"] == 0
    assert jnp.array_equal(a.faces, b.faces)
