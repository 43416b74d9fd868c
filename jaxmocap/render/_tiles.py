"""Tiles: the 8 x 8 squares of a key buffer, and those of them that differ from what lay below.

A limb fills a small part of the person, and the person of its rectangle. A sum over pixels each of which is dear is
therefore computed over some tiles only, or blocks of tiles, in a loop that is as long as the particle needs.
"""

from collections.abc import Callable, Sequence
from functools import reduce
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from ._expand import Driver, corner, look_up, running_sum
from ._keys import WINDOW
from ._windows import Places

_PIXELS_AT_ONCE: dict[Driver, int] = {"loop": 512, "scatter": 8192}
"""Listed pixels that are scored in each round of a loop; in a scatter as many of every particle."""


class Tiles(NamedTuple):
    """Row and column of the first pixel of each tile, counted without the border; the first `count` are meant."""

    rows: Int[Array, "tile"]
    columns: Int[Array, "tile"]
    count: Int[Array, ""]


def touched_rows(places: Places, padded_height: int) -> Int[Array, "2"]:
    """Find the band of a buffer's rows that faces at these `places` may touch, in eights: the first, and its end."""
    low, high = (of(jnp.stack([of(rows) for rows in places[1]])) for of in (jnp.min, jnp.max))
    low, high = jnp.nan_to_num(low, nan=-jnp.inf), jnp.nan_to_num(high, nan=jnp.inf)  # of no pose: anywhere
    ends = jnp.stack([jnp.floor(low), jnp.ceil(high) + WINDOW]) + WINDOW
    return jnp.clip(ends, 0, padded_height + WINDOW - 1).astype(jnp.int32) // WINDOW


def put_back(
    keys: Int[Array, "row column 1"], below: Int[Array, "row column 1"], band: Int[Array, "2"], first_row: Array
) -> Int[Array, "row column 1"]:
    """Copy a band of rows, in eights from `first_row` on, from the buffer `below`."""

    def rows(number: Array, keys: Array) -> Array:
        start = corner(first_row + WINDOW * number, 0, 0)
        return lax.dynamic_update_slice(keys, lax.dynamic_slice(below, start, (WINDOW, *below.shape[1:])), start)

    return lax.fori_loop(band[0], band[1], rows, keys)


def dirty_tiles(
    keys: Int[Array, "row padded_width 1"],
    below: Int[Array, "row padded_width 1"],
    size: tuple[int, int],
    band: Int[Array, "2"] | None = None,
    first_row: int | Array = 0,
) -> Bool[Array, "down across"]:
    """Mark the tiles in which a key differs from the one `below`, for a picture of this size whose buffer begins at
    `first_row`. With a band of rows, in eights, only these are looked at, one after the other."""
    down, across = (-(-extent // WINDOW) for extent in size)

    def changes(number: int | Array, count: int) -> Array:
        """Compare so many rows of tiles from one on."""
        start, extent = corner(first_row + WINDOW * (number + 1), WINDOW, 0), (WINDOW * count, WINDOW * across, 1)
        return lax.dynamic_slice(keys, start, extent) ^ lax.dynamic_slice(below, start, extent)

    if band is None:
        return (changes(0, down).reshape(down, WINDOW, across, WINDOW) != 0).any((1, 3))

    def row(number: Array, dirty: Array) -> Array:
        changed = changes(number, 1)
        any_row = reduce(jnp.bitwise_or, [changed[row, :, 0] for row in range(WINDOW)])  # vectorised, unlike `any`
        return lax.dynamic_update_slice(dirty, (any_row.reshape(across, WINDOW) != 0).any(1)[None], corner(number, 0))

    first, end = jnp.maximum(band[0] - 1, 0), jnp.minimum(band[1] - 1, down)
    return lax.fori_loop(first, end, row, jnp.zeros((down, across), bool))


def tiles_at(chosen: Bool[Array, "down across"], side: tuple[int, int] = (WINDOW, WINDOW)) -> Tiles:
    """List the chosen tiles, or blocks of other sides, in reading order. There is room for all."""
    marked = chosen.reshape(-1)
    ends = running_sum(marked.astype(jnp.int32))
    slots = jnp.where(marked, ends - 1, marked.size)
    starts = np.indices(chosen.shape, np.int32).reshape(2, -1) * np.array(side, np.int32)[:, None]
    rows, columns = (
        jnp.zeros(marked.size, jnp.int32).at[slots].set(value, mode="drop", unique_indices=True) for value in starts
    )
    return Tiles(rows, columns, ends[-1])


def _kept(count: Int[Array, ""], compute: Callable[[], tuple[Any, ...]]) -> tuple[Any, ...]:
    """`compute()` in a loop that is done once where there is anything to count: no compiler fuses across its end."""
    nothing = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), jax.eval_shape(compute))
    return lax.fori_loop(0, jnp.minimum(count, 1), lambda *_: compute(), nothing)


def sum_over_tiles(
    tiles: Tiles,
    cost: Callable[..., Float[Array, "n"]],
    step: int = 1,
    place: Callable[[Int[Array, "n"], Int[Array, "n"]], Sequence[Any]] = lambda rows, columns: (rows, columns),
    driver: Driver = "loop",
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Sum and number of the costs that are not negative over every `step`-th row and column of the tiles.

    `cost(*place(rows, columns))` is called for some hundred pixels at a time, for thousands on an accelerator, in a
    loop that is as long as the tiles need; it leaves a pixel out by a negative cost. A tile reaches up to seven pixels
    beyond the picture. What `place` finds is kept before `cost` reads it: XLA would else work out anew for each of
    several values that are looked up where they lie, which takes longer than the look-ups.
    """
    side = WINDOW // step  # a power of two: shifts, since XLA divides integers one by one
    bits = side.bit_length() - 1
    lanes = side * side
    count, capacity = tiles.count * lanes, tiles.rows.size * lanes
    at_once = min(_PIXELS_AT_ONCE[driver], capacity)

    def places(slots: Array) -> tuple[Any, ...]:
        tile, lane = slots >> (2 * bits), slots & (lanes - 1)
        rows = look_up(tiles.rows, tile) + (lane >> bits) * step
        columns = look_up(tiles.columns, tile) + (lane & (side - 1)) * step
        return tuple(place(rows, columns))

    def body(chunk: Array, sums: tuple[Array, Array]) -> tuple[Array, Array]:
        slots = chunk * at_once + jnp.arange(at_once)
        placed = _kept(count, lambda: places(jnp.minimum(slots, capacity - 1)))
        found = lax.optimization_barrier(jnp.where(slots < count, cost(*placed), -1.0))
        counted = found >= 0
        return sums[0] + jnp.where(counted, found, 0.0), sums[1] + counted.astype(jnp.float32)

    nothing = jnp.zeros(at_once)
    total, counted = lax.fori_loop(0, -(-count // at_once), body, (nothing, nothing))
    return total.sum(), counted.sum()


BLOCK = (16, 32)
"""Rows and columns of a block. Pixels side by side cost a third of listed ones; larger blocks hold more that are
clean."""


def block_sums(values: Float[Array, "*lead height width"]) -> Float[Array, "*lead block_down block_across"]:
    """Sum the pixels of every block."""
    (*lead, height, width), (tall, wide) = values.shape, BLOCK
    down, across = -(-height // tall), -(-width // wide)
    missing = [(0, 0)] * len(lead) + [(0, down * tall - height), (0, across * wide - width)]
    return jnp.pad(values, missing).reshape(*lead, down, tall, across, wide).sum((-3, -1))


def sum_over_blocks(
    dirty: Bool[Array, "down across"],
    size: tuple[int, int],
    known: Float[Array, "block_down block_across"],
    cost: Callable[[Array, Array, tuple[int, int]], Float[Array, "block_height block_width"]],
) -> Float[Array, ""]:
    """Sum the costs of a picture's pixels: of blocks with a dirty tile anew, of the others the `known` sum.

    `cost(row, column, block)` computes those of a block of these sides from its first pixel on. A block that would
    reach beyond the picture begins before its place, and only what is its own counts.
    """
    sides = (min(BLOCK[0], size[0]), min(BLOCK[1], size[1]))
    tall, wide, (down, across) = BLOCK[0] // WINDOW, BLOCK[1] // WINDOW, known.shape
    missing = [(0, down * tall - dirty.shape[0]), (0, across * wide - dirty.shape[1])]
    anew = jnp.pad(dirty, missing).reshape(down, tall, across, wide).any((1, 3))
    blocks, (own_row, own_column) = tiles_at(anew, BLOCK), np.indices(sides, np.int32)

    def body(number: Array, total: Array) -> Array:
        first_row, first_column = look_up(blocks.rows, number), look_up(blocks.columns, number)
        row, column = jnp.minimum(first_row, size[0] - sides[0]), jnp.minimum(first_column, size[1] - sides[1])
        own = (own_row >= first_row - row) & (own_column >= first_column - column)
        return total + jnp.where(own, cost(row, column, sides), 0.0)

    total = lax.fori_loop(0, blocks.count, body, jnp.zeros(sides))
    return total.sum() + jnp.where(anew, 0.0, known).sum()
