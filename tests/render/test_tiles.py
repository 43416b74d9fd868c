"""Sums over covered tiles against the same sums over all pixels."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmocap.render import (
    WINDOW,
    KeyLayout,
    block_sums,
    dirty_tiles,
    look_up,
    put_back,
    sum_over_blocks,
    sum_over_tiles,
    tiles_at,
    touched_rows,
)

LAYOUT = KeyLayout.for_faces(100)


def buffer_with(covered: np.ndarray) -> jax.Array:
    """A key buffer that is covered where the picture is True, and in its whole border."""
    keys = np.full(np.array(covered.shape) + 2 * WINDOW, LAYOUT.empty + 7, np.int32)
    keys[WINDOW:-WINDOW, WINDOW:-WINDOW] = np.where(covered, (5 << LAYOUT.id_bits) | 3, LAYOUT.empty)
    return jnp.asarray(keys)


def some_pixels(height: int, width: int, share: float, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).random((height, width)) < share


def covered_tiles(covered: np.ndarray) -> jax.Array:
    padded = np.pad(covered, [(0, -extent % WINDOW) for extent in covered.shape])
    return jnp.asarray(padded.reshape(padded.shape[0] // WINDOW, WINDOW, -1, WINDOW).any((1, 3)))


@pytest.mark.parametrize(("height", "width"), [(16, 24), (37, 50), (200, 160), (8, 8)])
@pytest.mark.parametrize("share", [0.0, 0.01, 1.0])
def test_tiles_are_those_that_were_chosen(height, width, share):
    chosen = covered_tiles(some_pixels(height, width, share))
    tiles = tiles_at(chosen)
    count = int(tiles.count)
    listed = np.stack([tiles.rows[:count], tiles.columns[:count]], 1)
    np.testing.assert_array_equal(listed, np.argwhere(np.asarray(chosen)) * WINDOW)


def below_and_drawn(height: int, width: int, first: int, end: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Two pictures' buffers below each other, rows of the second of which are changed; and where."""
    below = np.concatenate([buffer_with(some_pixels(height, width, 0.5, seed)) for seed in (0, 1)])
    changed = some_pixels(height, width, 0.02, seed=2) & (np.arange(height) >= first)[:, None]
    changed &= (np.arange(height) < end)[:, None]
    drawn = below + np.pad(changed, ((height + 3 * WINDOW, WINDOW), (WINDOW, WINDOW))).astype(np.int32)
    return below[..., None], drawn[..., None], changed


def touched(first: float, end: float, height: int) -> jax.Array:
    """The band that a face from row `first` to `end` touches."""
    rows = tuple(jnp.array([row, row], jnp.float32) for row in (first, end, (first + end) / 2))
    return touched_rows((rows, rows), height + 2 * WINDOW)


@pytest.mark.parametrize(("height", "width"), [(16, 24), (37, 50), (200, 160)])
@pytest.mark.parametrize(("first", "end"), [(0, 16), (3, 12), (9, 10), (-30, 5), (10, 1e6)])
def test_changed_tiles_are_those_with_another_key(height, width, first, end):
    below, drawn, changed = below_and_drawn(height, width, first, end)
    padded = np.pad(changed, ((0, -height % WINDOW), (0, -width % WINDOW)))
    expected = padded.reshape(padded.shape[0] // WINDOW, WINDOW, -1, WINDOW).any((1, 3))
    band, size, start = touched(first, end - 1, height), (height, width), height + 2 * WINDOW
    np.testing.assert_array_equal(dirty_tiles(drawn, below, size, band, start), expected)
    np.testing.assert_array_equal(dirty_tiles(drawn, below, size, None, start), expected)
    assert not np.any(dirty_tiles(drawn, below, size, touched(0, 1e6, height), 0))


@pytest.mark.parametrize(("first", "end"), [(0, 37), (3, 12), (-8, 45), (-30, 5), (30, 1e6), (np.nan, np.nan)])
def test_rows_that_were_touched_are_put_back(first, end):
    """Borders too, where faces are drawn as well."""
    height, width = 37, 50
    rows = np.arange(-WINDOW, height + WINDOW)
    changed = (rows >= np.nan_to_num(first, nan=-1e9)) & (rows < np.nan_to_num(end, nan=1e9))
    below = np.concatenate([buffer_with(some_pixels(height, width, 0.5, seed)) for seed in (0, 1)])[..., None]
    drawn = below + np.r_[np.zeros(rows.size, int), changed][:, None, None].astype(np.int32)
    band = touched(first, end - 1, height)
    np.testing.assert_array_equal(put_back(jnp.asarray(drawn), jnp.asarray(below), band, jnp.asarray(rows.size)), below)


@pytest.mark.parametrize(("height", "width"), [(8, 8), (16, 24), (37, 50), (200, 170)])
def test_blocks_sum_what_changed_anew_and_keep_the_rest(height, width):
    old, new = np.random.default_rng(0).random((2, height, width)).astype(np.float32)
    changed = some_pixels(height, width, 0.002, seed=1)
    changed[0, 0] = changed[-1, -1] = True
    padded = np.pad(changed, ((0, -height % WINDOW), (0, -width % WINDOW)))
    dirty = padded.reshape(padded.shape[0] // WINDOW, WINDOW, -1, WINDOW).any((1, 3))
    values, seen = np.where(np.kron(dirty, np.ones((WINDOW, WINDOW), bool))[:height, :width], new, old), []

    def cost(row, column, block):
        seen.append(block)
        return jax.lax.dynamic_slice(jnp.asarray(values), (row, column), block)

    total = sum_over_blocks(jnp.asarray(dirty), (height, width), block_sums(jnp.asarray(old)), cost)
    assert np.prod(seen[0]) <= 512
    np.testing.assert_allclose(total, values.sum(dtype=np.float64), rtol=1e-5)


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

    total, count = jax.jit(lambda: sum_over_tiles(tiles_at(covered_tiles(covered)), cost, step))()
    kept = covered[::step, ::step]
    assert int(count) == kept.sum()
    np.testing.assert_allclose(total, values[::step, ::step][kept].sum(dtype=np.float64), rtol=1e-5)


def test_tiles_under_vmap_are_those_of_each():
    pictures = np.stack([some_pixels(40, 48, share, seed) for seed, share in enumerate((0.0, 0.05, 0.9))])
    buffers = jnp.stack([buffer_with(picture) for picture in pictures])
    tiles = jnp.stack([covered_tiles(picture) for picture in pictures])

    def area(keys, tiles):
        def cost(rows, columns):
            index = (rows + WINDOW) * keys.shape[1] + columns + WINDOW
            return jnp.where(look_up(keys.reshape(-1), index) > LAYOUT.empty, 1.0, -1.0)

        return sum_over_tiles(tiles_at(tiles), cost)[1]

    np.testing.assert_array_equal(jax.vmap(area)(buffers, tiles), pictures.sum((1, 2)))
