"""Lists of what is counted: slots for items that occur several times each, on either kind of machine."""

from typing import Literal

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Int

_BLOCKS = 256

Driver = Literal["loop", "scatter"]
"""How windows are listed and drawn: one after the other, or all at once. Both make the same bits."""


def best_driver() -> Driver:
    """Choose the loop on a CPU; the scatter, under `vmap`, on everything else."""
    return "loop" if jax.default_backend() == "cpu" else "scatter"


def look_up(values: Array, index: Int[Array, "*n"]) -> Array:
    """Look up `values[index]` of a flat array for an index known to be inside: no wrapping, no clipping."""
    return values.at[index].get(mode="promise_in_bounds", wrap_negative_indices=False)


def corner(*places: int | Array) -> tuple[Array, ...]:
    """Bring the start of a `dynamic_slice` to one type, which JAX asks for: with `jax_enable_x64` some are wider."""
    return tuple(jnp.asarray(place, jnp.int32) for place in places)


def running_sum(values: Int[Array, "n"], block: int = 64) -> Int[Array, "n"]:
    """Sum cumulatively by triangular products of at most `_BLOCKS` columns.

    Exact below 2^24 and much faster than a scan on a CPU.
    """
    length = -(-values.shape[0] // block) * block
    rows = jnp.pad(values.astype(jnp.float32), (0, length - values.shape[0])).reshape(-1, block)
    inner = jnp.dot(rows, jnp.triu(jnp.ones((block, block), jnp.float32)), precision="highest")
    count, last = rows.shape[0], inner[:, -1]
    if count > _BLOCKS:
        outer = running_sum(last.astype(jnp.int32), block).astype(jnp.float32) - last
    else:
        outer = jnp.dot(last, jnp.triu(jnp.ones((count, count), jnp.float32), 1), precision="highest")
    return (inner + outer[:, None]).reshape(-1)[: values.shape[0]].astype(jnp.int32)


def expand(
    counts: Int[Array, "n"], capacity: int
) -> tuple[Int[Array, "capacity"], Int[Array, "capacity"], Int[Array, ""]]:
    """Repeat item i `counts[i]` times: the item and the rank within it for each slot, and the total."""
    used = counts > 0
    ends, order = running_sum(counts), running_sum(used.astype(jnp.int32)) - 1
    starts = ends - counts
    row, slot = jnp.where(used, order, counts.shape[0]), jnp.where(used, starts, capacity)
    place = {"mode": "drop", "unique_indices": True}
    items = jnp.zeros_like(counts).at[row].set(jnp.arange(counts.shape[0], dtype=jnp.int32), **place)
    marks = jnp.zeros(capacity, jnp.int32).at[slot].set(1, **place)
    item = look_up(items, jnp.maximum(running_sum(marks) - 1, 0))
    return item, jnp.arange(capacity, dtype=jnp.int32) - look_up(starts, item), ends[-1]


def listed(chosen: Bool[Array, "n"], capacity: int) -> tuple[Int[Array, "capacity"], Int[Array, ""]]:
    """List the items that are chosen, and how many; of more than `capacity`, as many at even distances."""
    rank = running_sum(chosen.astype(jnp.int32))
    share = rank * capacity // jnp.maximum(rank[-1], capacity)
    kept = share > jnp.pad(share[:-1], (1, 0))
    items = jnp.zeros(capacity, jnp.int32)
    items = items.at[jnp.where(kept, share - 1, capacity)].set(jnp.arange(len(chosen), dtype=jnp.int32), mode="drop")
    return items, share[-1]


def expand_one_by_one(
    counts: Int[Array, "n"], capacity: int
) -> tuple[Int[Array, "capacity"], Int[Array, "capacity"], Int[Array, ""]]:
    """Do what `expand` does, one item and one slot after the other: less than half the time on a CPU."""

    def put(values: Array, value: Array, slot: Array) -> Array:
        return lax.dynamic_update_slice(values, value.astype(jnp.int32)[None], (slot,))

    def mark(item: Array, found: tuple[Array, Array]) -> tuple[Array, Array]:
        marks, start = found  # an item without slots is overwritten by the next
        return put(marks, item, jnp.minimum(start, capacity)), start + look_up(counts, item)

    nothing = jnp.zeros((), jnp.int32)
    marks, total = lax.fori_loop(0, counts.shape[0], mark, (jnp.full(capacity + 1, -1, jnp.int32), nothing))

    def fill(slot: Array, found: tuple[Array, Array, Array, Array]) -> tuple[Array, Array, Array, Array]:
        items, ranks, item, rank = found
        marked = look_up(marks, slot)
        item, rank = jnp.where(marked >= 0, marked, item), jnp.where(marked >= 0, 0, rank + 1)
        return put(items, item, slot), put(ranks, rank, slot), item, rank

    empty = jnp.zeros(capacity, jnp.int32)
    items, ranks, _, _ = lax.fori_loop(0, jnp.minimum(total, capacity), fill, (empty, empty, nothing, nothing))
    return items, ranks, total
