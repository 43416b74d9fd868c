from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmocap._results import InputError
from jaxmocap.appearance import (
    GridSettings,
    background_distance,
    fit_background,
    fit_palette,
    grid_ids,
    grid_vertices,
    label_image,
    nearest_selected,
    psi,
    psi_table,
    warp_grid,
)

KEY = jax.random.key(0)
GRID = GridSettings(rows=6, columns=8)
STILL = warp_grid(np.zeros((0, 2)), np.zeros((0, 2)), (120, 160), grid=GRID)


def moved(shift):
    """The grid as it is, a few pixels on."""
    return replace(STILL, vertices=STILL.vertices + shift, rest=STILL.rest + shift)


def distance_of(model, warp, image, window=(slice(0, 120), slice(0, 160)), grid=GRID):
    """Psi_b in a window, from a table of the colours of the whole image."""
    palette = fit_palette(image)
    origin = (window[0].start, window[1].start)
    table = np.asarray(psi_table(model.colours, palette))
    return background_distance(table, warp, label_image(palette, image[window]), origin=origin, grid=grid)


@pytest.fixture
def fitted(street):
    image, mask = street
    return fit_background(image, mask, key=KEY, grid=GRID)


def test_background_is_near_and_a_foreign_object_far(street, fitted):
    image, mask = street
    pasted = image.copy()
    pasted[10:30, 10:30] = [0, 255, 255]
    distance = distance_of(fitted, STILL, pasted)
    foreign = np.zeros(mask.shape, bool)
    foreign[10:30, 10:30] = True
    assert distance[~mask & ~foreign].mean() < 0.05
    assert distance[foreign].min() == 1
    assert distance[mask].mean() > 0.95


def test_triangles_under_the_mask_copy_the_nearest_one_with_a_model(street, fitted):
    _, mask = street
    vertices = grid_vertices(120, 160, 6, 8)
    ids = grid_ids(vertices, 120, 160, GRID)
    y, x = np.mgrid[:120, :160]
    far = np.array([[((x - i) ** 2 + (y - j) ** 2)[mask].min() for i in range(160)] for j in range(120)])
    counts = np.bincount(ids[far > GRID.mask_dilation**2], minlength=96)
    source = np.asarray(fitted.source)
    np.testing.assert_array_equal(source == np.arange(96), counts >= GRID.min_pixels)
    assert (counts[source] >= GRID.min_pixels).all()
    assert bool(fitted.colours.valid.all())
    borrowed = np.flatnonzero(source != np.arange(96))
    assert len(borrowed) > 4
    np.testing.assert_array_equal(fitted.colours.means[borrowed], fitted.colours.means[source[borrowed]])


def test_a_window_is_close_to_the_exact_psi(street, fitted):
    image, _ = street
    warp, window = moved((3, -2)), (slice(20, 80), slice(30, 130))
    ids = grid_ids(warp.vertices, 60, 100, GRID, origin=(20, 30))
    exact = psi(fitted.colours, jnp.asarray(ids), jnp.asarray(image[window], jnp.float32) / 255)
    looked_up = distance_of(fitted, warp, image, window)
    assert np.sqrt(np.mean((looked_up - exact) ** 2)) < 0.04
    assert looked_up.dtype == np.float32


def test_pixels_without_a_triangle_are_at_the_barrier_if_not_filled(street, fitted):
    image, _ = street
    none = GridSettings(rows=6, columns=8, fill="none")
    distance = distance_of(fitted, moved((40, 0)), image, grid=none)
    assert (distance[:, :40] == 1).all()
    assert distance_of(fitted, moved((40, 0)), image)[:, :40].mean() < 0.5


def test_a_mask_over_everything_is_refused(street):
    image, mask = street
    with pytest.raises(InputError, match="leaves no background"):
        fit_background(image, np.ones_like(mask), key=KEY, grid=GRID)


@pytest.mark.parametrize(
    ("frame", "blend", "expected"),
    [
        (0, "nearest", (0,)),
        (24, "nearest", (0,)),
        (25, "nearest", (0,)),
        (26, "nearest", (1,)),
        (99, "nearest", (2,)),
        (20, "min", (0, 1)),
        (50, "min", (1,)),
        (99, "min", (2,)),
    ],
)
def test_the_closest_selected_frame_serves_and_the_earlier_one_on_a_tie(frame, blend, expected):
    assert nearest_selected(frame, (0, 50, 90), blend) == expected


def test_no_selected_frame_is_refused():
    with pytest.raises(InputError, match="No frame is selected"):
        nearest_selected(3, ())
