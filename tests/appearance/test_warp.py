import numpy as np
import pytest

from jaxmocap.appearance import GridSettings, WarpSettings, grid_vertices, warp_grid
from jaxmocap.appearance._grid_equations import similarity_normal
from jaxmocap.appearance._homography import apply_homography, robust_homography
from jaxmocap.appearance._warp import _roughness

SIZE = (540, 960)
HOMOGRAPHY = np.array([[1.05, 0.04, 20], [-0.03, 1.02, -15], [5e-5, -4e-5, 1]])


def parallax(points):
    x, y = points[:, 0] / SIZE[1], points[:, 1] / SIZE[0]
    return np.stack([12 * np.sin(3 * x + 1) * np.cos(2 * y), 5 * np.cos(4 * x) * np.sin(3 * y)], axis=1)


def truth(points):
    return apply_homography(HOMOGRAPHY, points) + parallax(points)


def features(count, rng):
    points = rng.random((count, 2)) * SIZE[::-1]
    return points[~((np.abs(points[:, 0] - 480) < 70) & (np.abs(points[:, 1] - 300) < 180))]


@pytest.mark.parametrize("prewarp", ["homography", "none"])
@pytest.mark.parametrize("alpha", [0.1, 3.0])
def test_a_similarity_is_reproduced_exactly(prewarp, alpha):
    points = np.random.default_rng(0).random((400, 2)) * SIZE[::-1]
    turn = 0.9 * np.array([[np.cos(0.3), np.sin(0.3)], [-np.sin(0.3), np.cos(0.3)]])
    warp = warp_grid(points, points @ turn.T + (30, -20), SIZE, WarpSettings(alphas=(alpha,), prewarp=prewarp))
    assert np.abs(warp.vertices - (grid_vertices(*SIZE) @ turn.T + (30, -20))).max() < 1e-6
    assert warp.residual < 1e-6


def test_homography_and_parallax_with_outliers_and_a_hole_stay_below_a_pixel():
    rng = np.random.default_rng(1)
    points = features(1360, rng)
    targets = truth(points) + rng.normal(size=points.shape) * 0.3
    wrong = rng.random(len(points)) < 0.1
    targets[wrong] += rng.normal(size=(wrong.sum(), 2)) * 40
    warp = warp_grid(points, targets, SIZE)
    regular = grid_vertices(*SIZE)
    error = np.linalg.norm(warp.vertices - truth(regular), axis=1)
    hole = (np.abs(regular[:, 0] - 480) < 70) & (np.abs(regular[:, 1] - 300) < 180)
    assert error.mean() < 0.5
    assert np.percentile(error, 95) < 1
    assert error[hole].mean() < 0.5
    plain = warp_grid(points, targets, SIZE, WarpSettings(prewarp="none"))
    assert np.linalg.norm(plain.vertices - truth(regular), axis=1).mean() > error.mean()


def test_the_similarity_term_is_the_printed_sum():
    rng = np.random.default_rng(2)
    rest = grid_vertices(60, 80, 3, 4) + rng.uniform(-2, 2, (20, 2))
    moved = rest + rng.uniform(-3, 3, rest.shape)
    normal = similarity_normal(rest, 3, 4)
    band = normal.band.reshape(normal.bandwidth + 1, normal.unknowns)
    lower = sum(np.diag(band[k, : normal.unknowns - k], -k) for k in range(normal.bandwidth + 1))
    full = lower + np.tril(lower, -1).T
    rotate = np.array([[0, 1], [-1, 0]])
    total = 0.0
    for row in range(3):
        for column in range(4):
            loop = [row * 5 + column, row * 5 + column + 1, row * 5 + column + 6, row * 5 + column + 5]
            for i in range(4):
                v1 = loop[i]
                for v0, v in ((loop[i - 1], loop[(i + 1) % 4]), (loop[(i + 1) % 4], loop[i - 1])):
                    e, f = rest[v0] - rest[v1], rest[v] - rest[v1]
                    u, w = f @ e / (e @ e), f @ (rotate @ e) / (e @ e)
                    edge = moved[v0] - moved[v1]
                    total += np.sum((moved[v] - moved[v1] - u * edge - w * rotate @ edge) ** 2)
    assert moved.ravel() @ full @ moved.ravel() == pytest.approx(total, rel=1e-9)
    turned = rest @ np.array([[0.5, 0.9], [-0.9, 0.5]]) + (3, 4)
    assert abs(turned.ravel() @ full @ turned.ravel()) < 1e-8


def test_robust_homography_survives_forty_percent_outliers():
    rng = np.random.default_rng(3)
    points = rng.random((300, 2)) * SIZE[::-1]
    targets = apply_homography(HOMOGRAPHY, points)
    wrong = rng.random(300) < 0.4
    targets[wrong] = rng.random((wrong.sum(), 2)) * SIZE[::-1]
    found = robust_homography(points, targets)
    assert np.abs(apply_homography(found, points) - apply_homography(HOMOGRAPHY, points)).max() < 1
    np.testing.assert_array_equal(found, robust_homography(points, targets))


def test_without_features_the_grid_stays():
    none = np.zeros((0, 2))
    regular = grid_vertices(*SIZE)
    np.testing.assert_array_equal(warp_grid(none, none, SIZE).vertices, regular)
    points = features(300, np.random.default_rng(4))
    earlier = warp_grid(points, points + (7, 3), SIZE)
    np.testing.assert_array_equal(warp_grid(none, none, SIZE, previous=earlier).vertices, earlier.vertices)


@pytest.mark.parametrize("count", [1, 2, 3, 5])
def test_very_few_features_move_the_whole_grid(count):
    points = np.random.default_rng(5).random((count, 2)) * SIZE[::-1]
    warp = warp_grid(points, points + (12, -5), SIZE)
    np.testing.assert_allclose(warp.vertices, grid_vertices(*SIZE) + (12, -5), atol=0.05)


def test_alpha_is_kept_between_choices():
    rng = np.random.default_rng(6)
    points = features(500, rng)
    settings = WarpSettings(choose_every=3)
    warp, ages = None, []
    for step in range(5):
        warp = warp_grid(points, truth(points) + (step, 0), SIZE, settings, warp)
        ages.append(warp.age)
        assert warp.alpha in settings.alphas
    assert ages == [0, 1, 2, 0, 1]


def test_cells_without_features_follow_the_previous_shape_under_camera_motion():
    rng = np.random.default_rng(7)
    points = features(800, rng)
    settings = WarpSettings(alphas=(0.1,))
    earlier = warp_grid(points, truth(points), SIZE, settings)
    left = points[points[:, 0] < 400]
    shift = np.array([25.0, -9.0])
    regular = grid_vertices(*SIZE)
    far = regular[:, 0] > 700
    with_memory = warp_grid(left, truth(left) + shift, SIZE, settings, earlier)
    without = warp_grid(left, truth(left) + shift, SIZE, settings)
    errors = [np.linalg.norm(w.vertices - truth(regular) - shift, axis=1)[far].mean() for w in (with_memory, without)]
    assert errors[0] < 0.8 * errors[1]


def test_other_grid_sizes_work():
    points = np.random.default_rng(8).random((300, 2)) * SIZE[::-1]
    warp = warp_grid(points, points + (4, 4), SIZE, grid=GridSettings(rows=10, columns=20))
    np.testing.assert_allclose(warp.vertices, grid_vertices(*SIZE, 10, 20) + 4, atol=1e-6)


def test_a_stiffer_grid_is_smoother_and_fits_its_features_less():
    points = features(1360, np.random.default_rng(9))
    regular, grid = grid_vertices(*SIZE), GridSettings()
    warps = [warp_grid(points, truth(points), SIZE, WarpSettings(alphas=(alpha,))) for alpha in (0.1, 1.0, 10.0)]
    roughness = [_roughness(regular, warp.vertices, grid) for warp in warps]
    assert (np.diff(roughness) < 0).all()
    assert (np.diff([warp.residual for warp in warps]) > 0).all()
    assert _roughness(regular, apply_homography(HOMOGRAPHY, regular), grid) < 1e-9
