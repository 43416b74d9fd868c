"""Sums over covered tiles against the same sums over all pixels."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmocap.render import (
    WINDOW,
    KeyLayout,
    covered_tiles,
    crop,
    dirty_tiles,
    empty_buffer,
    look_up,
    sum_in_chunks,
    sum_over_tiles,
    tiles_at,
)

LAYOUT = KeyLayout.for_faces(100)


def buffer_with(covered: np.ndarray) -> jax.Array:
    """A key buffer that is covered where the picture is True, and in its whole border."""
    keys = np.full(np.array(covered.shape) + 2 * WINDOW, LAYOUT.empty + 7, np.int32)
    keys[WINDOW:-WINDOW, WINDOW:-WINDOW] = np.where(covered, (5 << LAYOUT.id_bits) | 3, LAYOUT.empty)
    return jnp.asarray(keys)


def some_pixels(height: int, width: int, share: float, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).random((height, width)) < share


@pytest.mark.parametrize(("height", "width"), [(16, 24), (37, 50), (200, 160), (8, 8)])
@pytest.mark.parametrize("share", [0.0, 0.01, 1.0])
def test_tiles_are_those_with_a_covered_pixel(height, width, share):
    covered = some_pixels(height, width, share)
    padded = np.pad(covered, ((0, -height % WINDOW), (0, -width % WINDOW)))
    expected = np.argwhere(padded.reshape(padded.shape[0] // WINDOW, WINDOW, -1, WINDOW).any((1, 3))) * WINDOW
    whole = empty_buffer(LAYOUT, height, width).at[WINDOW:-WINDOW, WINDOW:-WINDOW].set(crop(buffer_with(covered)))
    tiles = tiles_at(covered_tiles(whole, LAYOUT))
    count = int(tiles.count)
    np.testing.assert_array_equal(np.stack([tiles.rows[:count], tiles.columns[:count]], 1), expected)


@pytest.mark.parametrize(("height", "width"), [(16, 24), (37, 50)])
def test_changed_tiles_are_those_with_another_key(height, width):
    below = np.asarray(buffer_with(some_pixels(height, width, 0.5)))
    changed = some_pixels(height, width, 0.02, seed=1)
    drawn = below + np.pad(changed, WINDOW).astype(np.int32)
    padded = np.pad(changed, ((0, -height % WINDOW), (0, -width % WINDOW)))
    expected = padded.reshape(padded.shape[0] // WINDOW, WINDOW, -1, WINDOW).any((1, 3))
    assert 0 < expected.sum() < expected.size
    both = jnp.stack([drawn, below]), jnp.stack([below, below])
    np.testing.assert_array_equal(dirty_tiles(*both), [expected, np.zeros_like(expected)])


@pytest.mark.parametrize("step", [1, 2, 4])
@pytest.mark.parametrize(("height", "width"), [(37, 50), (208, 176)])
def test_sums_are_those_over_the_pixels_that_count(height, width, step):
    covered = some_pixels(height, width, 0.2)
    keys = buffer_with(covered)
    values = np.random.default_rng(1).random((height, width)).astype(np.float32)
    padded = jnp.pad(jnp.asarray(values), WINDOW)

    def cost(rows, columns):
        index = (rows + WINDOW) * padded.shape[1] + columns + WINDOW
        counted = (look_up(keys.reshape(-1), index) > LAYOUT.empty) & (rows < height) & (columns < width)
        return jnp.where(counted, look_up(padded.reshape(-1), index), -1.0)

    total, count = jax.jit(lambda: sum_over_tiles(tiles_at(covered_tiles(keys, LAYOUT)), cost, step))()
    kept = covered[::step, ::step]
    assert int(count) == kept.sum()
    np.testing.assert_allclose(total, values[::step, ::step][kept].sum(dtype=np.float64), rtol=1e-5)


@pytest.mark.parametrize("count", [0, 1, 2047, 2048, 2049, 5000])
def test_slots_beyond_the_count_are_left_out(count):
    costs = jnp.where(jnp.arange(5000) % 3 == 0, -1.0, 1.0)
    total, counted = sum_in_chunks(jnp.asarray(count), 5000, lambda slots: look_up(costs, slots))
    expected = (np.asarray(costs[:count]) > 0).sum()
    assert float(total) == float(counted) == expected


def test_tiles_under_vmap_are_those_of_each():
    pictures = np.stack([some_pixels(40, 48, share, seed) for seed, share in enumerate((0.0, 0.05, 0.9))])
    buffers = jnp.stack([buffer_with(picture) for picture in pictures])

    def area(keys):
        def cost(rows, columns):
            index = (rows + WINDOW) * keys.shape[1] + columns + WINDOW
            return jnp.where(look_up(keys.reshape(-1), index) > LAYOUT.empty, 1.0, -1.0)

        return sum_over_tiles(tiles_at(covered_tiles(keys, LAYOUT)), cost)[1]

    np.testing.assert_array_equal(jax.vmap(area)(buffers), pictures.sum((1, 2)))
