"""Tiles: the 8 x 8 squares of a key buffer, those that are covered, or that differ from what lay below.

A person fills a small part of its rectangle, and a limb a small part of the person. A sum over pixels each of which is
dear is therefore computed over some tiles only, some dozen at a time, in a loop that is as long as the particle needs.
"""

from collections.abc import Callable, Sequence
from functools import reduce
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from ._keys import WINDOW, KeyLayout
from ._windows import look_up, running_sum

_PIXELS_AT_ONCE = 512


class Tiles(NamedTuple):
    """Row and column of the first pixel of each tile, counted without the border; the first `count` are meant."""

    rows: Int[Array, "tile"]
    columns: Int[Array, "tile"]
    count: Int[Array, ""]


def _highest(values: Int[Array, "*lead padded_height padded_width"]) -> Int[Array, "*lead down across"]:
    """Of each tile of a buffer with its border; the last tiles reach into it."""
    down, across = (-(-(extent - 2 * WINDOW) // WINDOW) for extent in values.shape[-2:])
    inner = values[..., WINDOW : WINDOW * (down + 1), WINDOW : WINDOW * (across + 1)]
    rows = reduce(jnp.maximum, [inner[..., row::WINDOW, :] for row in range(WINDOW)])  # vectorised, unlike `max`
    return rows.reshape(*rows.shape[:-1], across, WINDOW).max(-1)


def covered_tiles(
    buffer: Int[Array, "*lead padded_height padded_width"], layout: KeyLayout
) -> Bool[Array, "*lead down across"]:
    """Mark the tiles in which a pixel is covered."""
    return _highest(buffer) > layout.empty


def dirty_tiles(
    buffer: Int[Array, "*lead padded_height padded_width"], below: Int[Array, "*lead padded_height padded_width"]
) -> Bool[Array, "*lead down across"]:
    """Mark the tiles in which a key differs from that of another buffer."""
    return _highest(buffer ^ below) > 0


def tiles_at(chosen: Bool[Array, "down across"]) -> Tiles:
    """List the chosen tiles in reading order. There is room for all."""
    marked = chosen.reshape(-1)
    ends = running_sum(marked.astype(jnp.int32))
    slots = jnp.where(marked, ends - 1, marked.size)
    starts = (WINDOW * np.indices(chosen.shape, np.int32)).reshape(2, -1)
    rows, columns = (
        jnp.zeros(marked.size, jnp.int32).at[slots].set(value, mode="drop", unique_indices=True) for value in starts
    )
    return Tiles(rows, columns, ends[-1])


def sum_in_chunks(
    count: Int[Array, ""],
    capacity: int,
    cost: Callable[..., Float[Array, "n"]],
    place: Callable[[Int[Array, "n"]], Sequence[Any]] = lambda slots: (slots,),
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Sum and number of the costs that are not negative in the first `count` of `capacity` slots.

    `cost(*place(slots))` is called for some thousand slots at a time, in a loop that is as long as `count` needs. What
    `place` finds is kept before `cost` reads it: XLA would else work out anew for each of several values that are
    looked up where they lie, which takes longer than the look-ups.
    """
    at_once = min(_PIXELS_AT_ONCE, capacity)

    def body(chunk: Array, sums: tuple[Array, Array]) -> tuple[Array, Array]:
        slots = chunk * at_once + jnp.arange(at_once)
        placed = _kept(count, lambda: tuple(place(jnp.minimum(slots, capacity - 1))))
        found = lax.optimization_barrier(jnp.where(slots < count, cost(*placed), -1.0))
        counted = found >= 0
        return sums[0] + jnp.where(counted, found, 0.0), sums[1] + counted.astype(jnp.float32)

    nothing = jnp.zeros(at_once)
    total, counted = lax.fori_loop(0, -(-count // at_once), body, (nothing, nothing))
    return total.sum(), counted.sum()


def _kept(count: Int[Array, ""], compute: Callable[[], tuple[Any, ...]]) -> tuple[Any, ...]:
    """`compute()` in a loop that is done once where there is anything to count: no compiler fuses across its end."""
    nothing = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), jax.eval_shape(compute))
    return lax.fori_loop(0, jnp.minimum(count, 1), lambda *_: compute(), nothing)


def sum_over_tiles(
    tiles: Tiles,
    cost: Callable[..., Float[Array, "n"]],
    step: int = 1,
    place: Callable[[Int[Array, "n"], Int[Array, "n"]], Sequence[Any]] = lambda rows, columns: (rows, columns),
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Sum and number of the costs that are not negative over every `step`-th row and column of the covered tiles.

    `cost(*place(rows, columns))` leaves a pixel out by a negative cost; `place` as for `sum_in_chunks`. A tile holds
    pixels that are not covered, and reaches up to seven pixels beyond the picture.
    """
    side = WINDOW // step  # a power of two: shifts, since XLA divides integers one by one
    bits = side.bit_length() - 1
    lanes = side * side

    def in_tiles(slots: Array) -> Sequence[Any]:
        tile, lane = slots >> (2 * bits), slots & (lanes - 1)
        rows = look_up(tiles.rows, tile) + (lane >> bits) * step
        columns = look_up(tiles.columns, tile) + (lane & (side - 1)) * step
        return place(rows, columns)

    return sum_in_chunks(tiles.count * lanes, tiles.rows.size * lanes, cost, in_tiles)
