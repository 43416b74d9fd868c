"""Contour points of a drawn sphere and the edges they find in a picture of a displaced disc."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from meshes import camera_at, sphere
from scoring import FRAME

from jaxmocap.character import retract, skin
from jaxmocap.energies import ContourSettings, contour_lines, contour_points, edge_targets
from jaxmocap.observation import image_edges, mask_edges
from jaxmocap.render import face_ids

HEIGHT = WIDTH = 160
FOCAL = 200.0
DISC, RING, GROUND = (220, 120, 60), (250, 250, 250), (20, 40, 90)
SETTINGS = ContourSettings(capacity=1024)


@pytest.fixture(scope="module")
def ball():
    """Ids and inverse depth of a sphere, and centre and radius of its outline in pixels (row and column indices)."""
    vertices, faces = sphere(40, 60, 0.5)
    camera = camera_at(2.0, 0.0, 0.0)
    intrinsics = np.array([[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1]])
    ids, inverse = face_ids(
        jnp.asarray(vertices, jnp.float32), jnp.asarray(faces, jnp.int32), jnp.asarray(intrinsics[None], jnp.float32),
        jnp.asarray(camera[None], jnp.float32), jnp.zeros((1, 2), jnp.int32), HEIGHT, WIDTH,
    )  # fmt: skip
    radius = FOCAL * 0.5 / np.sqrt(2.0**2 - 0.5**2)
    return ids[0], inverse[0], np.array([WIDTH / 2 - 0.5, HEIGHT / 2 - 0.5]), radius


def picture_of_disc(centre, radius, inside=DISC, outside=GROUND):
    """A crisp picture, every pixel the mean of 64 samples."""
    samples = (np.arange(8 * WIDTH) + 0.5) / 8 - 0.5
    x, y = np.meshgrid(samples, samples)
    share = ((x - centre[0]) ** 2 + (y - centre[1]) ** 2 < radius**2).reshape(HEIGHT, 8, WIDTH, 8).mean((1, 3))
    image = share[..., None] * np.array(inside) + (1 - share[..., None]) * np.array(outside)
    return np.round(image).astype(np.uint8)


_points = jax.jit(contour_points)
_targets = jax.jit(edge_targets)


def search(points, image, edges=None, known=True, colour=DISC, settings=SETTINGS):
    mask, gradient = image_edges(image) if edges is None else edges
    slots = len(np.asarray(points.face))
    found, accepted = _targets(
        points, jnp.asarray(mask), jnp.asarray(gradient, jnp.float32), jnp.asarray(image / 255.0, jnp.float32),
        jnp.tile(jnp.asarray(colour, jnp.float32) / 255, (slots, 1)), jnp.full(slots, known), settings,
    )  # fmt: skip
    return np.asarray(found), np.asarray(accepted)


def test_contour_points_are_on_the_outline_with_normals_inward(ball):
    ids, inverse, centre, radius = ball
    points = _points(ids, inverse, SETTINGS)
    live = np.asarray(points.live)
    place = np.stack([points.column, points.row], -1)[live] - centre
    assert 100 < live.sum() < 2 * np.pi * radius
    np.testing.assert_allclose(np.linalg.norm(place, axis=1), radius - 0.5, atol=1.0)
    inward = -place / np.linalg.norm(place, axis=1, keepdims=True)
    turned = np.rad2deg(np.arccos(np.clip((inward * np.asarray(points.normal)[live]).sum(1), -1, 1)))
    assert turned.mean() < 7
    assert turned.max() < 20
    row, column = np.asarray(points.row)[live], np.asarray(points.column)[live]
    np.testing.assert_array_equal(np.asarray(ids)[row, column], np.asarray(points.face)[live])


def test_step_thins_the_contour(ball):
    ids, inverse, _, _ = ball
    every = int(_points(ids, inverse, ContourSettings(capacity=1024, step=1)).live.sum())
    third = int(_points(ids, inverse, ContourSettings(capacity=1024, step=3)).live.sum())
    np.testing.assert_allclose(every / third, 3, rtol=0.15)


def test_a_full_list_of_contour_points_stays_within_its_capacity(ball):
    ids, inverse, _, _ = ball
    points = _points(ids, inverse, ContourSettings(capacity=32))
    assert points.live.shape == (32,)
    assert np.all(points.live)


def test_of_more_contour_points_than_there_is_room_for_even_ones_are_kept_down_to_the_lowest(ball):
    ids, inverse, _, _ = ball

    def places(capacity):
        points = _points(ids, inverse, ContourSettings(capacity=capacity, step=1))
        return np.stack([points.row, points.column], -1)[np.asarray(points.live)].tolist()

    every, kept = places(1024), places(100)
    assert len(every) > 130
    assert len(kept) == 100
    ranks = [every.index(place) for place in kept]
    assert ranks[-1] == len(every) - 1
    assert set(np.diff(ranks).tolist()) <= {len(every) // 100, len(every) // 100 + 1}


@pytest.mark.parametrize("shift", [(0.0, 0.0), (4.0, 0.0), (-3.0, 5.0), (0.0, -8.0)])
def test_a_displaced_edge_is_found_to_a_pixel(ball, shift):
    ids, inverse, centre, radius = ball
    points = _points(ids, inverse, SETTINGS)
    moved = centre + np.array(shift)
    found, accepted = search(points, picture_of_disc(moved, radius))
    assert accepted.sum() > 0.9 * np.asarray(points.live).sum()
    assert not accepted[~np.asarray(points.live)].any()
    distance = np.linalg.norm(found[accepted] - moved, axis=1) - radius
    assert np.abs(distance).max() < 1.5
    assert np.abs(distance).mean() < 0.7
    # Along the normal: the change of radius seen from the drawn sphere is the shift's share of it.
    outward = -np.asarray(points.normal)[accepted]
    travelled = ((found - np.stack([points.column, points.row], -1))[accepted] * outward).sum(1)
    ahead = (outward * shift).sum(1)
    expected = ahead + np.sqrt(radius**2 - np.sum(np.square(shift)) + ahead**2) - radius
    assert np.abs(travelled - expected).mean() < 1.0


def test_an_edge_beyond_reach_is_not_found(ball):
    ids, inverse, centre, radius = ball
    points = _points(ids, inverse, SETTINGS)
    _, accepted = search(points, picture_of_disc(centre, radius - 25))
    assert not accepted.any()
    _, accepted = search(points, np.full((HEIGHT, WIDTH, 3), 90, np.uint8))
    assert not accepted.any()


def test_an_edge_across_the_contour_is_not_accepted(ball):
    """Radial stripes: edges everywhere, all at right angles to the outline."""
    ids, inverse, centre, _ = ball
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    stripes = np.sin(24 * np.arctan2(y - centre[1], x - centre[0])) > 0
    image = np.where(stripes[..., None], DISC, GROUND).astype(np.uint8)
    _, accepted = search(_points(ids, inverse, SETTINGS), image)
    assert accepted.mean() < 0.02


def test_the_edge_of_the_right_colour_wins_over_a_nearer_one(ball):
    """A ring of another colour lies outside the disc: its outer edge is as near as the disc's own."""
    ids, inverse, centre, radius = ball
    points = _points(ids, inverse, SETTINGS)
    disc = picture_of_disc(centre, radius - 5, DISC, RING)
    ring = picture_of_disc(centre, radius + 4, RING)
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    inner = np.hypot(x - centre[0], y - centre[1]) < radius - 1
    image = np.where(inner[..., None], disc, ring)
    for colour, expected in ((DISC, radius - 5), (RING, radius + 4)):
        found, accepted = search(points, image, colour=colour)
        assert accepted.sum() > 100
        place = np.linalg.norm(found[accepted] - centre, axis=1)
        assert np.mean(np.abs(place - expected) < 1.5) > 0.9


def test_rows_of_the_true_pose_find_the_outline_of_the_mask(world):
    """Every row ties the surface to the mask's outline; nothing is to be done at the truth."""
    lines, vertices = mask_lines(world, np.zeros(39))
    distance = np.linalg.norm(lines.residual(vertices), axis=1)
    live = np.asarray(lines.weight) > 0
    assert live.sum() > 150
    assert np.median(distance[live]) < 0.008  # a pixel is about 9 mm at this distance
    assert np.all(np.isfinite(np.asarray(lines.residual(vertices))))


def test_rows_of_a_displaced_pose_say_by_how_much(world):
    """Three centimetres to the side: rows on the left and right outlines see them, rows above and below do not."""
    delta = np.zeros(39)
    delta[0] = 0.03
    lines, vertices = mask_lines(world, delta)
    live = np.asarray(lines.weight) > 0
    points = np.asarray(lines.points(vertices), np.float64)[live]
    direction = np.asarray(lines.direction, np.float64)[live]
    nearest = np.cross(direction, np.asarray(lines.moment, np.float64)[live])  # point of the line nearest the origin
    along = ((points - nearest) * direction).sum(1, keepdims=True)
    move = nearest + along * direction - points
    sideways = np.abs(move[:, 0]) > 0.012
    assert sideways.sum() > 60
    np.testing.assert_allclose(np.median(move[sideways, 0]), -0.028, atol=0.008)


def mask_lines(world, delta, **settings):
    problem, character = world.problem(FRAME), world.character
    masks = world.masks(FRAME)
    edges = [mask_edges(mask) for mask in masks]
    problem = eqx.tree_at(
        lambda p: (p.edges.mask, p.edges.gradient),
        problem,
        (jnp.asarray(np.stack([e[0] for e in edges])), jnp.asarray(np.stack([e[1] for e in edges]), jnp.float32)),
    )
    vertices = skin(character, retract(character.skeleton, world.pose(FRAME), jnp.asarray(delta, jnp.float32)))
    ids, inverse = face_ids(
        vertices, character.faces, problem.intrinsics, problem.cam_from_world, problem.origins, *problem.size
    )
    looking = ContourSettings(capacity=512, accept_cosine=0.5, accept_score=0.8, **settings)
    return contour_lines(vertices, character.faces, ids, inverse, problem, looking), vertices


def test_edges_within_some_pixels_are_those_of_a_shorter_reach(world):
    delta = np.zeros(39)
    delta[0] = 0.12
    shorter, far = (mask_lines(world, delta, reach=reach)[0] for reach in (4, 15))
    within = mask_lines(world, delta, reach=15, within=4.0)[0]
    np.testing.assert_array_equal(within.weight, shorter.weight)
    tied = np.asarray(within.weight) > 0  # the others have any direction
    for name in ("corners", "direction", "moment"):
        np.testing.assert_allclose(getattr(within, name)[tied], getattr(shorter, name)[tied], rtol=1e-5, err_msg=name)
    assert shorter.weight.sum() < 0.9 * far.weight.sum()
