"""The hard rasteriser: faces -> 8 x 8 windows -> packed keys.

Each front face is cut into windows on a grid that starts at its own bounding box, so that a window's numbers do not
depend on the rectangle being drawn and a limb drawn over a body gives the same bits as both drawn together. Set-up is
one vectorised pass over the faces; the windows are then applied one after the other (the fast form on a CPU,
where XLA turns the loop into one in-place kernel) or all at once by a scatter (the form for a GPU or TPU).
"""

from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from ._keys import WINDOW, KeyLayout

_FAR_PIXEL = 30000.0
_BLOCKS = 256


class Jobs(NamedTuple):
    """Windows to draw. `records (capacity, 12)`: two barycentric planes, the depth plane, x, y, face (as bits)."""

    records: Float[Array, "capacity 12"]
    count: Int[Array, ""]
    needed: Int[Array, ""]


def to_screen(
    vertices: Float[Array, "vertex 3"], projection: Float[Array, "3 4"], origin: Int[Array, "2"]
) -> Float[Array, "3 vertex"]:
    """Rows: column and row relative to the centre of the rectangle's first pixel, and inverse depth (<= 0 is
    behind)."""
    homogeneous = projection[:, :3] @ vertices.T + projection[:, 3:]
    depth = homogeneous[2]
    inverse = jnp.where(depth > 1e-3, 1.0 / jnp.maximum(depth, 1e-3), -1.0)
    column = homogeneous[0] * jnp.abs(inverse) - (origin[1].astype(jnp.float32) + 0.5)
    row = homogeneous[1] * jnp.abs(inverse) - (origin[0].astype(jnp.float32) + 0.5)
    return jnp.stack([column, row, inverse])


def _as_float(value: Int[Array, "*n"]) -> Float[Array, "*n"]:
    return lax.bitcast_convert_type(value.astype(jnp.int32), jnp.float32)


def _as_int(value: Float[Array, "*n"]) -> Int[Array, "*n"]:
    return lax.bitcast_convert_type(value, jnp.int32)


def look_up(values: Array, index: Int[Array, "*n"]) -> Array:
    """`values[index]` of a flat array, for an index that is known to be inside: no wrapping, no clipping."""
    return values.at[index].get(mode="promise_in_bounds", wrap_negative_indices=False)


def running_sum(values: Int[Array, "n"], block: int = 64) -> Int[Array, "n"]:
    """Cumulative sum by triangular products of at most `_BLOCKS` columns: exact below 2^24 and much faster than a scan
    on a CPU."""
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
    """Item i repeated `counts[i]` times: the item and the rank within it for each slot, and the total."""
    used = counts > 0
    ends, order = running_sum(counts), running_sum(used.astype(jnp.int32)) - 1
    starts = ends - counts
    row, slot = jnp.where(used, order, counts.shape[0]), jnp.where(used, starts, capacity)
    place = {"mode": "drop", "unique_indices": True}
    items = jnp.zeros_like(counts).at[row].set(jnp.arange(counts.shape[0], dtype=jnp.int32), **place)
    marks = jnp.zeros(capacity, jnp.int32).at[slot].set(1, **place)
    item = look_up(items, jnp.maximum(running_sum(marks) - 1, 0))
    return item, jnp.arange(capacity, dtype=jnp.int32) - starts[item], ends[-1]


def window_jobs(
    screen: Float[Array, "3 vertex"],
    faces: Int[Array, "3 face"],
    face_numbers: Int[Array, "face"],
    active: Bool[Array, "face"] | None,
    height: int,
    width: int,
    depth_range: Float[Array, "2"],
    layout: KeyLayout,
    capacity: int,
    corner: Int[Array, "2"] | None = None,
) -> Jobs:
    """Set-up of every front face that touches a rectangle of `height` x `width` pixels, expanded to windows.

    `corner` is the row and column, in the coordinates of `screen`, of the buffer's first pixel (default 0, 0). Faces
    are front-facing when counter-clockwise seen from outside. Faces with a vertex behind the camera are dropped.
    `needed > capacity` says that windows were dropped; the caller draws again with a larger capacity.
    """
    top, left = (jnp.zeros((), jnp.int32),) * 2 if corner is None else (corner[0], corner[1])
    x, y, inverse = lax.optimization_barrier(
        tuple(tuple(look_up(values, corner) for corner in faces) for values in screen)
    )
    scale = layout.depth_levels / (depth_range[1] - depth_range[0])
    level = [jnp.clip((d - depth_range[0]) * scale, 0.0, float(layout.depth_levels)) + 1.0 for d in inverse]
    low_x, low_y, low_inverse = (jnp.minimum(jnp.minimum(a, b), c) for a, b, c in (x, y, inverse))
    high_x, high_y = (jnp.maximum(jnp.maximum(a, b), c) for a, b, c in (x, y))
    start_x, start_y = jnp.ceil(low_x), jnp.ceil(low_y)
    last_x, last_y = jnp.floor(high_x), jnp.floor(high_y)
    near = (low_inverse > 0) & (jnp.minimum(low_x, low_y) > -_FAR_PIXEL) & (jnp.maximum(high_x, high_y) < _FAR_PIXEL)
    hit = (last_x >= left) & (last_y >= top) & (start_x <= left + width - 1) & (start_y <= top + height - 1)
    hit &= (last_x >= start_x) & (last_y >= start_y)

    ax, bx, cx = (value - start_x for value in x)
    ay, by, cy = (value - start_y for value in y)
    area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    draw_it = near & hit & (area < -1e-8)
    if active is not None:
        draw_it &= active
    inv_area = 1.0 / jnp.where(draw_it, area, -1.0)
    a0, b0 = -(cy - by) * inv_area, (cx - bx) * inv_area
    a1, b1 = -(ay - cy) * inv_area, (ax - cx) * inv_area
    c0, c1 = -(a0 * bx + b0 * by), -(a1 * cx + b1 * cy)
    d0, d1 = level[0] - level[2], level[1] - level[2]
    az, bz, cz = a0 * d0 + a1 * d1, b0 * d0 + b1 * d1, c0 * d0 + c1 * d1 + level[2]

    def whole(value: Array) -> Array:
        return jnp.where(draw_it, value, 0.0).astype(jnp.int32)

    first_x, first_y = whole(start_x), whole(start_y)
    skip_x, skip_y = jnp.maximum(left - first_x, 0) // WINDOW, jnp.maximum(top - first_y, 0) // WINDOW
    end_x = (jnp.minimum(whole(last_x), left + width - 1) - first_x) // WINDOW
    end_y = (jnp.minimum(whole(last_y), top + height - 1) - first_y) // WINDOW
    across = jnp.where(draw_it, end_x - skip_x + 1, 0)
    item, rank, needed = expand(across * jnp.where(draw_it, end_y - skip_y + 1, 0), capacity)

    table = jnp.stack(
        [a0, b0, c0, a1, b1, c1, az, bz, cz]
        + [_as_float(v) for v in (first_x, first_y, skip_x, skip_y, jnp.maximum(across, 1), face_numbers)]
        + [a0],
        axis=1,
    )[item]
    first_x, first_y, skip_x, skip_y, across, number = (_as_int(table[:, k]) for k in range(9, 15))
    step_y = rank // across
    offset_x, offset_y = (skip_x + rank - step_y * across) * WINDOW, (skip_y + step_y) * WINDOW
    fx, fy = offset_x.astype(jnp.float32), offset_y.astype(jnp.float32)
    records = jnp.stack(
        [
            *(table[:, 0], table[:, 1], table[:, 2] + table[:, 0] * fx + table[:, 1] * fy),
            *(table[:, 3], table[:, 4], table[:, 5] + table[:, 3] * fx + table[:, 4] * fy),
            *(table[:, 6], table[:, 7], table[:, 8] + table[:, 6] * fx + table[:, 7] * fy),
            _as_float(first_x + offset_x - left + WINDOW),
            _as_float(first_y + offset_y - top + WINDOW),
            _as_float(number),
        ],
        axis=1,
    )
    return Jobs(records, jnp.minimum(needed, capacity), needed)


def _window_keys(record: Float[Array, "12"], layout: KeyLayout) -> Int[Array, "8 8"]:
    lane_x = jnp.arange(WINDOW, dtype=jnp.float32)[None, :]
    lane_y = jnp.arange(WINDOW, dtype=jnp.float32)[:, None]
    first = record[2] + record[0] * lane_x + record[1] * lane_y
    second = record[5] + record[3] * lane_x + record[4] * lane_y
    level = record[8] + record[6] * lane_x + record[7] * lane_y
    inside = jnp.minimum(jnp.minimum(first, second), 1.0 - first - second) >= 0
    bounded = jnp.clip(level, 1.0, layout.depth_levels + 1.0).astype(jnp.int32)
    return jnp.where(inside, (bounded << layout.id_bits) | _as_int(record[11]), 0)


Driver = Literal["loop", "scatter"]
"""How windows are drawn: one after the other, or all at once. Both make the same bits."""


def best_driver() -> Driver:
    """The loop on a CPU; the scatter, under `vmap`, on everything else."""
    return "loop" if jax.default_backend() == "cpu" else "scatter"


def draw(
    buffer: Int[Array, "padded_height padded_width"],
    jobs: Jobs,
    layout: KeyLayout,
    first_row: int | Array = 0,
    driver: Driver | None = None,
) -> Int[Array, "padded_height padded_width"]:
    """Draw the windows into the buffer, whose picture may start further down at `first_row`. The default driver is the
    machine's `best_driver`."""
    put = draw_in_turn if (driver or best_driver()) == "loop" else draw_scatter
    return put(buffer, jobs, layout, first_row)


def draw_in_turn(
    buffer: Int[Array, "padded_height padded_width"], jobs: Jobs, layout: KeyLayout, first_row: int | Array = 0
) -> Int[Array, "padded_height padded_width"]:
    """Draw the windows one after the other. Iterate particles with `lax.map`, not `vmap`."""

    def body(i: Array, keys: Array) -> Array:
        record = jobs.records[i]
        corner = (_as_int(record[10]) + first_row, _as_int(record[9]))
        old = lax.dynamic_slice(keys, corner, (WINDOW, WINDOW))
        return lax.dynamic_update_slice(keys, jnp.maximum(old, _window_keys(record, layout)), corner)

    return lax.fori_loop(0, jobs.count, body, buffer)


def draw_scatter(
    buffer: Int[Array, "padded_height padded_width"], jobs: Jobs, layout: KeyLayout, first_row: int | Array = 0
) -> Int[Array, "padded_height padded_width"]:
    """Draw all windows at once by a scatter of maxima: the form for `vmap` on a GPU or TPU. Same keys, same bits."""
    keys = jax.vmap(lambda record: _window_keys(record, layout))(jobs.records)
    live = (jnp.arange(jobs.records.shape[0]) < jobs.count)[:, None, None]
    lanes = jnp.arange(WINDOW)
    index_x = _as_int(jobs.records[:, 9])[:, None, None] + lanes[None, None, :]
    index_y = first_row + _as_int(jobs.records[:, 10])[:, None, None] + lanes[None, :, None]
    flat = jnp.where(live & (keys > 0), index_y * buffer.shape[1] + index_x, buffer.size)
    return buffer.reshape(-1).at[flat.reshape(-1)].max(keys.reshape(-1), mode="drop").reshape(buffer.shape)
