import jax
import numpy as np
import pytest

from jaxmocap.appearance import ColourSettings, ForegroundSettings, fit_foreground, psi
from jaxmocap.appearance._foreground import face_neighbours, usable_pixels

KEY = jax.random.key(0)
FACES = np.array([[0, 1, 2], [2, 1, 3], [2, 3, 4], [4, 3, 5], [6, 7, 8]])
"""A strip of four triangles, and one alone."""
COLOURS = np.array([[200, 20, 20], [20, 200, 20], [20, 20, 200], [200, 200, 20], [20, 200, 200]])


def views(counts):
    """One row of pixels per camera: triangle ids repeated, and an image in the triangles' colours."""
    ids = np.full((3, 400), -1)
    row = np.repeat(np.arange(len(counts)), counts)
    ids[:, : len(row)] = np.where(np.arange(3)[:, None] == 1, row, -1)
    rng = np.random.default_rng(len(row))
    image = np.clip(COLOURS[np.maximum(ids, 0)] + rng.normal(size=(*ids.shape, 3)) * 2, 0, 255).astype(np.uint8)
    return ids, image


def fit(counts_per_camera, **options):
    settings = ForegroundSettings(**{"erosion": 0, **options})
    pairs = [views(counts) for counts in counts_per_camera]
    facing = [[np.ones(len(FACES)) for _ in pairs]]
    return fit_foreground(
        [[ids for ids, _ in pairs]], [[image for _, image in pairs]], facing, FACES, key=KEY, settings=settings
    )


def test_neighbours_share_an_edge():
    np.testing.assert_array_equal(
        face_neighbours(FACES), [[-1, 1, -1], [0, -1, 2], [1, 3, -1], [2, -1, -1], [-1, -1, -1]]
    )


def test_usable_pixels_are_inside_and_facing():
    ids = np.full((9, 9), -1)
    ids[1:8, 1:8] = 0
    ids[:, 5:8] = np.where(ids[:, 5:8] >= 0, 1, -1)
    silhouette = np.ones((9, 9), bool)
    silhouette[:4] = False
    used = usable_pixels(ids, np.array([0.9, 0.1]), silhouette, ForegroundSettings(erosion=1))
    expected = np.zeros((9, 9), bool)
    expected[5:7, 2:5] = True
    np.testing.assert_array_equal(used, expected)
    per_pixel = np.where(ids == 1, 0.1, 0.9)
    np.testing.assert_array_equal(usable_pixels(ids, per_pixel, silhouette, ForegroundSettings()), expected)


def test_each_camera_has_its_own_model_else_the_pooled_one_else_none():
    model = fit([[50, 50, 0, 50, 0], [60, 0, 50, 3, 0]], pool_ring=0)
    np.testing.assert_array_equal(model.source, [[1, 1, 2, 1, 0], [1, 2, 1, 2, 0]])
    np.testing.assert_array_equal(model.colours.valid, np.asarray(model.source) > 0)
    np.testing.assert_array_equal(model.pixel_counts, [[50, 50, 0, 50, 0], [60, 0, 50, 3, 0]])
    means = np.asarray(model.mean_colours())
    np.testing.assert_allclose(means[:, :4], np.tile(COLOURS[:4] / 255, (2, 1, 1)), atol=0.01)
    assert (means[:, 4] == 0).all()


@pytest.mark.parametrize(
    ("per_camera", "expected"), [("camera", [[1, 0, 0, 0, 0], [0, 1, 0, 0, 0]]), ("pooled", [[2, 2, 0, 0, 0]] * 2)]
)
def test_models_of_one_camera_only_or_of_all(per_camera, expected):
    model = fit([[50, 0, 0, 0, 0], [0, 50, 0, 0, 0]], per_camera=per_camera, pool_ring=0)
    np.testing.assert_array_equal(model.source, expected)


def test_a_poor_triangle_borrows_from_the_ring_and_an_unseen_one_does_not():
    counts = [[100, 5, 100, 0, 20]]
    with_ring, without = fit(counts, pool_ring=1), fit(counts, pool_ring=0)
    np.testing.assert_array_equal(with_ring.source, [[1, 1, 1, 0, 1]])
    np.testing.assert_array_equal(without.source, [[1, 0, 1, 0, 1]])
    expected = (100 * COLOURS[0] + 5 * COLOURS[1] + 100 * COLOURS[2]) / 205 / 255
    np.testing.assert_allclose(with_ring.mean_colours()[0, 1], expected, atol=0.01)
    np.testing.assert_allclose(with_ring.mean_colours()[0, 0], COLOURS[0] / 255, atol=0.01)


def test_psi_is_small_on_the_right_triangle_and_tau_on_a_wrong_one():
    model = fit([[60, 60, 60, 60, 0]])
    ids, image = views([60, 60, 60, 60, 0])
    colours = image[1, :240].astype(np.float32) / 255
    right = psi(model.camera(0), ids[1, :240], colours, ColourSettings())
    wrong = psi(model.camera(0), (ids[1, :240] + 1) % 4, colours, ColourSettings())
    assert float(right.max()) < 0.05
    assert float(wrong.min()) == 1
    unseen = psi(model.camera(0), np.full(240, 4), colours, ColourSettings())
    assert float(unseen.min()) == 1


def test_pixels_of_all_selected_frames_are_used():
    first, second = views([30, 0, 0, 0, 0]), views([0, 30, 0, 0, 0])
    ids, images = [[first[0]], [second[0]]], [[first[1]], [second[1]]]
    facing = [[np.ones(5)], [np.ones(5)]]
    model = fit_foreground(ids, images, facing, FACES, key=KEY, settings=ForegroundSettings(erosion=0, pool_ring=0))
    np.testing.assert_array_equal(model.pixel_counts, [[30, 30, 0, 0, 0]])
