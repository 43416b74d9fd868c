"""The hard rasteriser's second half: windows -> packed keys in a buffer.

They are drawn one after the other (the fast form on a CPU, where XLA turns the loop into one in-place kernel) or all at
once by a scatter (the form for a GPU or TPU).
"""

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Int

from ._expand import Driver, best_driver, corner, look_up
from ._keys import WINDOW, KeyLayout
from ._windows import WindowList, opaque_zero, planned_windows, rounded

_AT_ONCE = 512  # windows that are planned together before they are drawn in turn


def _window_keys(
    planes: tuple[Array, ...], face: Int[Array, ""], layout: KeyLayout, zero: Int[Array, ""]
) -> Int[Array, "8 8 1"]:
    """Compute the keys of a face in a window, 0 where it is not.

    The last axis is there for XLA on a CPU: it unrolls the innermost loop, and of two loops the columns would be
    unrolled and the rows, which lie far apart, become vectors.
    """
    lane_x = jnp.arange(WINDOW, dtype=jnp.float32)[None, :, None]
    lane_y = jnp.arange(WINDOW, dtype=jnp.float32)[:, None, None]
    first, second, level = (
        c + rounded(a * lane_x, zero) + rounded(b * lane_y, zero) for a, b, c in (planes[:3], planes[3:6], planes[6:])
    )
    inside = (first >= 0) & (second >= 0) & (1.0 - first - second >= 0)
    bounded = jnp.clip(level, 1.0, layout.depth_levels + 1.0).astype(jnp.int32)
    return jnp.where(inside, (bounded << layout.id_bits) | face, 0)


def draw(
    buffer: Int[Array, "padded_height padded_width *one"],
    listed: WindowList,
    layout: KeyLayout,
    first_row: int | Array = 0,
    driver: Driver | None = None,
) -> Int[Array, "padded_height padded_width *one"]:
    """Draw the windows into the buffer, whose picture may start further down at `first_row`.

    The default driver is the machine's `best_driver`. In a loop give the buffer a last axis of length one: XLA would
    copy it to add one.
    """
    put = draw_one_by_one if (driver or best_driver()) == "loop" else draw_scatter
    return put(buffer, listed, layout, first_row)


def draw_one_by_one(
    buffer: Int[Array, "padded_height padded_width *one"],
    listed: WindowList,
    layout: KeyLayout,
    first_row: int | Array = 0,
) -> Int[Array, "padded_height padded_width *one"]:
    """Draw the windows one after the other, some hundred planned at a time, so that empty slots cost nothing.

    Iterate particles with `lax.map`, not `vmap`.
    """
    capacity = listed.item.shape[0]
    at_once = min(_AT_ONCE, capacity)
    missing = -capacity % at_once
    zero = opaque_zero(listed)
    items, ranks = (jnp.pad(values, (0, missing)) for values in (listed.item, listed.rank))

    def some(chunk: Array, keys: Array) -> Array:
        first = chunk * at_once
        windows = planned_windows(
            listed, *(lax.dynamic_slice(values, (first,), (at_once,)) for values in (items, ranks))
        )

        def one(i: Array, keys: Array) -> Array:
            planes, column, row, face = jax.tree.map(lambda values: look_up(values, i), windows)
            start = corner(row + first_row, column, 0)
            old = lax.dynamic_slice(keys, start, (WINDOW, WINDOW, 1))
            return lax.dynamic_update_slice(keys, jnp.maximum(old, _window_keys(planes, face, layout, zero)), start)

        return lax.fori_loop(0, jnp.minimum(listed.count - first, at_once), one, keys)

    keys = lax.fori_loop(0, -(-listed.count // at_once), some, buffer.reshape(*buffer.shape[:2], 1))
    return keys.reshape(buffer.shape)


def draw_scatter(
    buffer: Int[Array, "padded_height padded_width *one"],
    listed: WindowList,
    layout: KeyLayout,
    first_row: int | Array = 0,
) -> Int[Array, "padded_height padded_width *one"]:
    """Draw all windows at once by a scatter of maxima: the form for `vmap` on a GPU or TPU. Same keys, same bits."""
    windows = planned_windows(listed, listed.item, listed.rank)
    zero = opaque_zero(listed)
    keys = jax.vmap(lambda planes, face: _window_keys(planes, face, layout, zero)[..., 0])(windows.planes, windows.face)
    live = (jnp.arange(listed.item.shape[0]) < listed.count)[:, None, None]
    lanes = jnp.arange(WINDOW)
    index_x = windows.column[:, None, None] + lanes[None, None, :]
    index_y = first_row + windows.row[:, None, None] + lanes[None, :, None]
    flat = jnp.where(live & (keys > 0), index_y * buffer.shape[1] + index_x, buffer.size)
    return buffer.reshape(-1).at[flat.reshape(-1)].max(keys.reshape(-1), mode="drop").reshape(buffer.shape)
