"""Pictures as squares of a quadtree."""

import numpy as np
import pytest

from jaxmocap.baselines import colour_cone, image_gaussians


def painted(squares, shape) -> np.ndarray:
    """How often every pixel lies in a square."""
    count = np.zeros(shape, int)
    for (x, y), sigma in zip(squares.centres, squares.sigmas, strict=True):
        rows, columns = (slice(round(c - sigma), round(c + sigma)) for c in (y, x))
        count[rows, columns] += 1
    return count


def test_squares_of_one_colour_tile_the_picture():
    picture = np.zeros((64, 96, 3))
    picture[8:16, 40:48] = (1.0, 0.5, 0.0)
    squares = image_gaussians(picture, tolerance=0.1, smallest=2)
    assert np.all(painted(squares, (64, 96)) == 1)
    bright = squares.colours[:, 0] > 0
    np.testing.assert_allclose(squares.centres[bright], [[44.0, 12.0]])
    assert squares.sigmas[bright] == 4.0
    np.testing.assert_allclose(squares.colours[bright], [[1.0, 0.5, 0.0]])
    assert squares.sigmas.max() == 16.0
    assert len(squares.sigmas) == 6 - 1 + 3 + 3 + 1  # 32, 16, 8 and the bright one pixels wide


def test_what_never_comes_to_one_colour_ends_at_the_smallest_square():
    rows, columns = np.mgrid[:40, :40]
    picture = np.repeat(((rows + columns) % 2)[..., None], 3, -1).astype(float)
    squares = image_gaussians(picture, smallest=4)
    assert np.all(squares.sigmas == 2.0)
    assert len(squares.sigmas) == 100
    np.testing.assert_allclose(squares.colours, 0.5)
    assert len(image_gaussians(picture, tolerance=1.0).sigmas) < 10  # sqrt(3) / 2 is one colour then


def test_the_colour_cone_holds_neighbours_together():
    np.testing.assert_allclose(colour_cone(np.array([1.0, 0.0, 0.0])), [1.0, 0.0, 1.0])
    np.testing.assert_allclose(colour_cone(np.array([0.4, 0.4, 0.4])), [0.0, 0.0, 0.4], atol=1e-12)
    green = colour_cone(np.array([0.0, 0.5, 0.0]))
    np.testing.assert_allclose(green, [0.5 * np.cos(np.radians(120)), 0.5 * np.sin(np.radians(120)), 0.5])
    orange_red, purple_red = colour_cone(np.array([[1.0, 0.02, 0.0], [1.0, 0.0, 0.02]]))
    assert np.linalg.norm(orange_red - purple_red) == pytest.approx(0.0346, abs=2e-3)
