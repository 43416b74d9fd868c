import numpy as np
import pytest

from jaxmocap.appearance import GridSettings, grid_ids, grid_triangles, grid_vertices, similarity_residuals

HEIGHT, WIDTH = 108, 192
GRID = GridSettings(rows=6, columns=8)


@pytest.fixture
def regular():
    return grid_vertices(HEIGHT, WIDTH, GRID.rows, GRID.columns)


def covering(vertices, triangles, points):
    """Which triangles strictly contain which points, by the signs of three areas."""
    a, b, c = (vertices[triangles[:, i]][:, None] for i in range(3))

    def cross(p, q, r):
        first, second = q - p, r - p
        return first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0]

    signs = np.stack([cross(a, b, points), cross(b, c, points), cross(c, a, points)])
    return (signs > 1e-9).all(axis=0) | (signs < -1e-9).all(axis=0)


def centres(height, width):
    y, x = np.mgrid[:height, :width] + 0.5
    return np.stack([x.ravel(), y.ravel()], axis=1)


def test_the_undeformed_grid_gives_the_analytic_triangle():
    vertices = grid_vertices(540, 960)
    ids = grid_ids(vertices, 540, 960)
    y, x = np.mgrid[:540, :960] + 0.5
    u, v = x / 60, y / 33.75
    cell = v.astype(int) * 16 + u.astype(int)
    below = (v % 1) > (u % 1)
    clear = np.abs((v % 1) - (u % 1)) > 1e-9
    np.testing.assert_array_equal(ids[clear], (2 * cell + below)[clear])
    np.testing.assert_array_equal(ids // 2, cell)
    assert len(vertices) == 289
    assert len(grid_triangles()) == 512


def test_a_deformed_grid_has_neither_gaps_nor_wrong_triangles(regular):
    rng = np.random.default_rng(0)
    vertices = regular + rng.uniform(-6, 6, regular.shape)
    border = (regular == 0).any(axis=1) | (regular == (WIDTH, HEIGHT)).any(axis=1)
    vertices[border] = regular[border]
    triangles = grid_triangles(GRID.rows, GRID.columns)
    ids = grid_ids(vertices, HEIGHT, WIDTH, GridSettings(rows=6, columns=8, fill="none"))
    assert (ids >= 0).all()
    inside = covering(vertices, triangles, centres(HEIGHT, WIDTH))
    owner = np.where(inside.any(axis=0), inside.argmax(axis=0), ids.ravel())
    assert inside.any(axis=0).mean() > 0.98
    np.testing.assert_array_equal(ids.ravel(), owner)


def test_a_window_is_a_cut_out_of_the_whole(regular):
    vertices = regular + np.random.default_rng(1).uniform(-3, 3, regular.shape)
    whole = grid_ids(vertices, HEIGHT, WIDTH, GRID, rest=regular)
    window = grid_ids(vertices, 40, 60, GRID, rest=regular, origin=(30, 50))
    np.testing.assert_array_equal(window, whole[30:70, 50:110])


def test_uncovered_pixels_take_the_nearest_triangle_or_none(regular):
    shifted = regular + (30, 20)
    none = grid_ids(shifted, HEIGHT, WIDTH, GridSettings(rows=6, columns=8, fill="none"))
    y, x = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    np.testing.assert_array_equal(none < 0, (x < 30) | (y < 20))
    filled = grid_ids(shifted, HEIGHT, WIDTH, GRID)
    assert (filled >= 0).all()
    points = centres(HEIGHT, WIDTH)[(none < 0).ravel()]
    clipped = np.maximum(points, (30.5, 20.5))
    corners = shifted[grid_triangles(GRID.rows, GRID.columns)[filled[none < 0]]]
    low, high = corners.min(axis=1), corners.max(axis=1)
    gap = np.maximum(np.maximum(low - clipped, clipped - high), 0).max(axis=1)
    assert gap.max() < 3


def test_a_grid_that_left_the_image_still_answers(regular):
    ids = grid_ids(regular + (5 * WIDTH, 0), HEIGHT, WIDTH, GRID)
    assert set(np.unique(ids // 2 % GRID.columns)) == {0}


def test_where_triangles_fold_over_the_most_similar_one_is_kept(regular):
    vertices = regular.copy()
    vertices[3 * (GRID.columns + 1) + 4] += (40, 5)
    triangles = grid_triangles(GRID.rows, GRID.columns)
    residual = similarity_residuals(vertices, regular, triangles)
    ids = grid_ids(vertices, HEIGHT, WIDTH, GRID, rest=regular).ravel()
    inside = covering(vertices, triangles, centres(HEIGHT, WIDTH))
    folded = inside.sum(axis=0) > 1
    assert folded.sum() > 100
    best = np.where(inside, residual[:, None], np.inf).min(axis=0)
    np.testing.assert_allclose(residual[ids[folded]], best[folded], atol=1e-9)


def test_similarity_residual_is_zero_for_similarities_and_large_for_mirrors(regular):
    triangles = grid_triangles(GRID.rows, GRID.columns)
    turned = regular @ (1.3 * np.array([[0.8, -0.6], [0.6, 0.8]])).T + (5, 6)
    assert similarity_residuals(turned, regular, triangles).max() < 1e-9
    assert similarity_residuals(regular * (-1, 1), regular, triangles).min() > 5
