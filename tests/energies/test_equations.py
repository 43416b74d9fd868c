"""Eqs 6 and 7 and the silhouette energy against NumPy, pixel by pixel."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from scoring import FRAME, energy_of, score

from jaxmocap.camera import project
from jaxmocap.character import retract, skin
from jaxmocap.energies import are_near, covered_cost, partner_pixels, pixel_transfer, uncovered_cost
from jaxmocap.geometry import faces_within, pack_rows
from jaxmocap.render import face_ids


@pytest.mark.parametrize(
    ("truth", "foreground", "background", "covered", "uncovered"),
    [
        ("person, right triangle", 0, 1, 0.0, 0.5),
        ("person, triangle of another colour or without a model", 1, 1, 0.5, 0.5),
        ("background, any wrong triangle", 1, 0, 1.0, 0.0),
        ("camouflage", 0, 0, 0.5, 0.0),
    ],
)
def test_table_of_equation_6(truth, foreground, background, covered, uncovered):
    foreground, background = jnp.asarray(float(foreground)), jnp.asarray(float(background))
    np.testing.assert_allclose(covered_cost(foreground, background), covered, atol=2e-3, err_msg=truth)
    np.testing.assert_allclose(uncovered_cost(background), uncovered, atol=2e-3, err_msg=truth)
    # Without the guard against 0 / 0 the table holds exactly.
    if foreground + background > 0:
        np.testing.assert_allclose(covered_cost(foreground, background, 0.0), covered, atol=1e-7)
    np.testing.assert_allclose(uncovered_cost(background, 0.0), uncovered, atol=1e-7)


@pytest.fixture(scope="module")
def poses(world):
    """Increments: the truth, a turned body with bent joints, and bodies outside the rectangle and the picture."""
    increments = np.zeros((4, 39), np.float32)
    increments[1] = np.random.default_rng(5).normal(size=39) * 0.1
    increments[1, :6] *= 0.3  # nothing leaves the rectangle
    increments[2, 0], increments[3, 0] = -1.9, 3.0
    return increments


@pytest.fixture(scope="module")
def scored(world, poses):
    return score(world, poses)


def seen(world, increment):
    """Posed vertices, and face numbers in the rectangle, of an increment of the truth."""
    problem, character = world.problem(FRAME), world.character
    vertices = skin(character, retract(character.skeleton, world.pose(FRAME), jnp.asarray(increment)))
    cameras = problem.intrinsics, problem.cam_from_world, problem.origins
    ids, _ = face_ids(vertices, character.faces, *cameras, *problem.size)
    return np.asarray(vertices, np.float64), np.asarray(ids)


@pytest.mark.parametrize("which", [0, 1])
def test_model_view_is_equation_6(world, poses, scored, which):
    problem = world.problem(FRAME)
    _, ids = seen(world, poses[which])
    table = np.asarray(problem.surface.colour_distance, np.float64)
    total = 0.0
    for camera in range(2):
        background = np.asarray(problem.background[camera], np.float64)
        foreground = table[camera][np.maximum(ids[camera], 0), np.asarray(problem.labels[camera])]
        covered = (foreground + 1e-3) / (foreground + background + 2e-3)
        uncovered = (background + 1e-3) / (background + 1.002)
        total += np.where(ids[camera] >= 0, covered, uncovered).sum() / float(problem.area)
    assert 0.1 < total < 2
    np.testing.assert_allclose(scored["model_view"][which], total, atol=5e-4)


@pytest.mark.parametrize("which", [0, 1])
def test_silhouette_is_the_symmetric_difference(world, poses, scored, which):
    _, ids = seen(world, poses[which])
    masks, total = world.masks(FRAME), 0.0
    for camera in range(2):
        wrong = ((ids[camera] >= 0) != masks[camera]).sum()
        total += 0.25 * (wrong / (ids[camera] >= 0).sum() + wrong / masks[camera].sum())
    assert total < 0.02 if which == 0 else total > 0.2
    np.testing.assert_allclose(scored["silhouette"][which], total, atol=5e-4)


def bilinear(image, x, y):
    """Colours at columns x and rows y, whole numbers being pixel centres, the border repeated."""
    height, width = image.shape[:2]
    x, y = np.clip(x, 0, width - 1), np.clip(y, 0, height - 1)
    left, top = np.minimum(x.astype(int), width - 2), np.minimum(y.astype(int), height - 2)
    fx, fy = (x - left)[:, None], (y - top)[:, None]
    upper = image[top, left] * (1 - fx) + image[top, left + 1] * fx
    lower = image[top + 1, left] * (1 - fx) + image[top + 1, left + 1] * fx
    return upper * (1 - fy) + lower * fy


def matched(world, vertices, ids, near, m, n):
    """Per covered pixel of view m: colour distance in view n, whether the faces are near, whether n's picture has it.

    The surface point is the ray's intersection with the plane of the face, in double precision.
    """
    problem = world.problem(FRAME)
    rows, columns = np.nonzero(ids[m] >= 0)
    face = ids[m][rows, columns]
    origin_m, origin_n = np.asarray(problem.origins[m]), np.asarray(problem.origins[n])
    camera_m = np.asarray(problem.cam_from_world[m], np.float64)
    pixels = np.stack([columns + origin_m[1] + 0.5, rows + origin_m[0] + 0.5, np.ones(len(rows))], -1)
    rays = pixels @ np.linalg.inv(np.asarray(problem.intrinsics[m], np.float64)).T @ camera_m[:3, :3]
    centre = -camera_m[:3, :3].T @ camera_m[:3, 3]
    a, b, c = (vertices[np.asarray(world.character.faces)[face, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    points = centre + rays * (((a - centre) * normal).sum(1) / (rays * normal).sum(1))[:, None]
    there = np.c_[points, np.ones(len(points))] @ np.asarray(problem.projection[n], np.float64).T
    x, y = (there[:, :2] / there[:, 2:] - origin_n[::-1] - 0.5).T
    height, width = problem.size
    column, row = np.round(x).astype(int), np.round(y).astype(int)
    inside = (column >= 0) & (row >= 0) & (column < width) & (row < height)
    other = np.where(inside, ids[n][np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)], -1)
    images = np.asarray(problem.image, np.float64)
    colour = np.linalg.norm(images[m][rows, columns] - bilinear(images[n], x, y), axis=1)
    return np.minimum(colour, 1.0), (other >= 0) & near[face, np.maximum(other, 0)], inside


@pytest.fixture(scope="module")
def near(world):
    return faces_within(np.asarray(world.character.faces), 5).toarray()


@pytest.mark.parametrize("which", [0, 1])
def test_view_view_is_equation_7(world, poses, scored, near, which):
    vertices, ids = seen(world, poses[which])
    printed = agreeing = 0.0
    for m, n in ((0, 1), (1, 0)):
        colour, close, _ = matched(world, vertices, ids, near, m, n)
        assert close.mean() > 0.5
        printed += np.where(close, colour, 1.0).mean()
        agreeing += colour[close].mean()
    np.testing.assert_allclose(scored["view_view"][which], printed, atol=2e-3)
    np.testing.assert_allclose(scored["colour"][which], agreeing, atol=2e-3)


def test_a_body_outside_the_rectangle_costs_its_area_and_the_barrier(world, poses, scored):
    """Eq. 6 counts the pixels of its front faces as 1 and the rectangle as uncovered; Eq. 7 is tau per pair. Faces
    whose centre lies outside the picture count nothing."""
    problem = world.problem(FRAME)
    vertices, ids = seen(world, poses[2])
    assert np.all(ids == -1)
    background = np.asarray(problem.background, np.float64)
    uncovered = ((background + 1e-3) / (background + 1.002)).sum()
    area = 0.0
    for camera in range(2):
        there = np.c_[vertices, np.ones(len(vertices))] @ np.asarray(problem.projection[camera], np.float64).T
        corners = (there[:, :2] / there[:, 2:])[np.asarray(world.character.faces)]
        u, v = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        signed = 0.5 * (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])
        centre = corners.mean(axis=1)
        shown = ((centre >= 0) & (centre <= np.array(world.cameras.sizes[camera]))).all(axis=1)
        area += -signed[(signed < 0) & shown].sum()
    assert area > 5000
    np.testing.assert_allclose(scored["model_view"][2], (uncovered + area) / float(problem.area), rtol=1e-3)
    np.testing.assert_allclose(scored["model_view"][3], uncovered / float(problem.area), rtol=1e-4)
    free = eqx.tree_at(lambda e: e.terms[0].outside, energy_of(world), jnp.asarray(0.0, jnp.float32))
    np.testing.assert_allclose(score(world, poses[2:3], free)["model_view"], uncovered / float(problem.area), rtol=1e-4)
    np.testing.assert_allclose(scored["view_view"][2], 2.0, atol=1e-6)


def test_uncovered_scale_of_two_doubles_what_uncovered_pixels_cost(world, poses, scored):
    symmetric = eqx.tree_at(lambda e: e.terms[0].uncovered_scale, energy_of(world), jnp.asarray(2.0, jnp.float32))
    doubled = score(world, poses[:1], symmetric)["model_view"][0]
    problem = world.problem(FRAME)
    background = np.asarray(problem.background, np.float64)
    _, ids = seen(world, poses[0])
    uncovered = ((background + 1e-3) / (background + 1.002))[ids < 0].sum() / float(problem.area)
    np.testing.assert_allclose(doubled - scored["model_view"][0], uncovered, rtol=2e-3)


def test_partner_is_where_the_other_camera_sees_the_point(world):
    problem = world.problem(FRAME)
    points = jnp.asarray(world.vertices(FRAME)[::50])
    view = lambda c: (problem.intrinsics[c], problem.cam_from_world[c])  # noqa: E731
    (here, depth), (there, _) = project(*view(0), points), project(*view(1), points)
    x, y, z = partner_pixels(here[:, 0], here[:, 1], 1 / depth, pixel_transfer(*problem.projection[:2]))
    np.testing.assert_allclose(jnp.stack([x, y], -1), there, atol=2e-3)
    assert np.all(np.asarray(z) > 0)


def test_bit_table_answers_for_every_pair(world, near):
    faces = np.asarray(world.character.faces)
    words = jnp.asarray(pack_rows(faces_within(faces, 5)))
    pairs = np.random.default_rng(0).integers(0, len(faces), (2, 4000))
    close = np.stack(np.nonzero(near[:40]))
    pairs = np.concatenate([pairs, close], 1).astype(np.int32)
    np.testing.assert_array_equal(
        are_near(words, jnp.asarray(pairs[0]), jnp.asarray(pairs[1])), near[pairs[0], pairs[1]]
    )
    assert near[pairs[0], pairs[1]].sum() >= close.shape[1]
