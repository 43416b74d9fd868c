"""The hard rasteriser: faces -> 8 x 8 windows -> packed keys.

Each front face is cut into windows on a grid that starts at its own bounding box, so that a window's numbers do not
depend on the rectangle being drawn and a limb drawn over a body gives the same bits as both drawn together. One
vectorised pass over the faces counts their windows; the windows that there are get their planes from the corners of
their faces, and are drawn one after the other (the fast form on a CPU, where XLA turns the loop into one in-place
kernel) or all at once by a scatter (the form for a GPU or TPU).
"""

from collections.abc import Sequence
from typing import Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Complex, Float, Int

from ._keys import WINDOW, KeyLayout

_FAR_PIXEL = 30000.0
_BLOCKS = 256
_AT_ONCE = 512  # windows that are planned together before they are drawn in turn
BEHIND = 1e6
"""Column and row of a vertex behind the camera: beyond all that is drawn, and finite."""

Places = tuple[tuple[Float[Array, "n"], ...], tuple[Float[Array, "n"], ...]]
"""Columns and rows of the three corners of faces."""

Driver = Literal["loop", "scatter"]
"""How windows are listed and drawn: one after the other, or all at once. Both make the same bits."""


def best_driver() -> Driver:
    """Choose the loop on a CPU; the scatter, under `vmap`, on everything else."""
    return "loop" if jax.default_backend() == "cpu" else "scatter"


class WindowList(eqx.Module):
    """Windows to draw: slot i holds window number `rank[i]` of face `item[i]`, for the first `count` of `capacity`
    slots. The rest is what their planes are computed from."""

    item: Int[Array, "capacity"]
    rank: Int[Array, "capacity"]
    count: Int[Array, ""]
    needed: Int[Array, ""]
    faces: Int[Array, "3 face"]
    numbers: Int[Array, "face"]
    points: Complex[Array, "vertex"]
    levels: Float[Array, "vertex"]
    size: tuple[int, int] = eqx.field(static=True)


class Windows(NamedTuple):
    """Windows ready to draw. `planes` are a, b, c of a x + b y + c over a window's pixels: two barycentric ones and the
    depth level's. `column` and `row` are of its first pixel in the padded buffer."""

    planes: tuple[Float[Array, "n"], ...]
    column: Int[Array, "n"]
    row: Int[Array, "n"]
    face: Int[Array, "n"]


def to_screen(
    vertices: Float[Array, "vertex 3"], projection: Float[Array, "3 4"], origin: Int[Array, "2"]
) -> Float[Array, "3 vertex"]:
    """Project vertices to the screen: column and row from the centre of the rectangle's first pixel, inverse depth.

    An inverse depth <= 0 is behind the camera.
    """
    places = vertices.T
    column, row, depth = (sum(line[k] * places[k] for k in range(3)) + line[3] for line in projection)
    inverse = jnp.where(depth > 1e-3, 1.0 / jnp.maximum(depth, 1e-3), -1.0)
    column = column * jnp.abs(inverse) - (origin[1].astype(jnp.float32) + 0.5)
    row = row * jnp.abs(inverse) - (origin[0].astype(jnp.float32) + 0.5)
    return jnp.stack([column, row, inverse])


def _in_windows(pixels: Int[Array, "*n"]) -> Int[Array, "*n"]:
    """Whole windows in so many pixels, rounded down. XLA divides integers one by one, and guards each division."""
    return pixels >> (WINDOW.bit_length() - 1)


def look_up(values: Array, index: Int[Array, "*n"]) -> Array:
    """Look up `values[index]` of a flat array for an index known to be inside: no wrapping, no clipping."""
    return values.at[index].get(mode="promise_in_bounds", wrap_negative_indices=False)


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


def screen_points(screen: Float[Array, "3 vertex"]) -> Complex[Array, "vertex"]:
    """Write column and row as one complex number, since look-ups are what takes time.

    Those of a vertex behind the camera are `BEHIND`.
    """
    seen = screen[2] > 0
    columns, rows = (jnp.where(seen, place, BEHIND) for place in screen[:2])
    return lax.optimization_barrier(lax.complex(columns, rows))


def corner_places(points: Complex[Array, "vertex"], faces: Sequence[Int[Array, "n"]] | Int[Array, "3 n"]) -> Places:
    """Look up columns and rows of the three corners of every face."""
    corners = lax.optimization_barrier(tuple(look_up(points, corner) for corner in faces))
    return tuple(jnp.real(corner) for corner in corners), tuple(jnp.imag(corner) for corner in corners)


def doubled_area(places: Places) -> Float[Array, "face"]:
    """Compute twice the area of every face on the screen, negative for front faces."""
    (ax, bx, cx), (ay, by, cy) = places
    return (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)


class _Setup(NamedTuple):
    """Of some faces: their first pixel, the corners from there, twice the area, and the windows of the buffer that they
    touch: how many are skipped before the buffer's edge, how many there are across and down."""

    first: tuple[Int[Array, "n"], Int[Array, "n"]]
    places: Places
    area: Float[Array, "n"]
    skip: tuple[Int[Array, "n"], Int[Array, "n"]]
    across: Int[Array, "n"]
    down: Int[Array, "n"]
    drawn: Bool[Array, "n"]


def _set_up(places: Places, height: int, width: int) -> _Setup:
    (low_x, high_x), (low_y, high_y) = (
        (jnp.minimum(jnp.minimum(a, b), c), jnp.maximum(jnp.maximum(a, b), c)) for a, b, c in places
    )
    start_x, start_y, last_x, last_y = jnp.ceil(low_x), jnp.ceil(low_y), jnp.floor(high_x), jnp.floor(high_y)
    near = (jnp.minimum(low_x, low_y) > -_FAR_PIXEL) & (jnp.maximum(high_x, high_y) < _FAR_PIXEL)
    hit = (last_x >= 0) & (last_y >= 0) & (start_x <= width - 1) & (start_y <= height - 1)
    hit &= (last_x >= start_x) & (last_y >= start_y)
    moved = (tuple(x - start_x for x in places[0]), tuple(y - start_y for y in places[1]))
    area = doubled_area(moved)
    drawn = near & hit & (area < -1e-8)

    def whole(value: Array) -> Array:
        return jnp.where(drawn, value, 0.0).astype(jnp.int32)

    first_x, first_y = whole(start_x), whole(start_y)
    skip_x, skip_y = _in_windows(jnp.maximum(-first_x, 0)), _in_windows(jnp.maximum(-first_y, 0))
    end_x = _in_windows(jnp.minimum(whole(last_x), width - 1) - first_x)
    end_y = _in_windows(jnp.minimum(whole(last_y), height - 1) - first_y)
    return _Setup((first_x, first_y), moved, area, (skip_x, skip_y), end_x - skip_x + 1, end_y - skip_y + 1, drawn)


class Faces(NamedTuple):
    """Corners of faces, their numbers in the whole mesh, and which of them to draw (None: all)."""

    corners: Int[Array, "3 face"]
    numbers: Int[Array, "face"]
    active: Bool[Array, "face"] | None = None


def window_list(
    screen: Float[Array, "3 vertex"],
    faces: Faces,
    size: tuple[int, int],
    depth_range: Float[Array, "2"],
    layout: KeyLayout,
    capacity: int,
    driver: Driver | None = None,
) -> tuple[WindowList, Places]:
    """List the windows of every front face that touches a rectangle of `size` (height, width) pixels.

    Returns with them the corners of all faces on the screen.

    Faces are front-facing when counter-clockwise seen from outside. Faces with a vertex behind the camera are dropped.
    `needed > capacity` says that windows were dropped; the caller draws again with a larger capacity. The default
    driver is the machine's `best_driver`.
    """
    points = screen_points(screen)
    places = corner_places(points, faces.corners)
    seen = _set_up(places, *size)
    drawn = seen.drawn if faces.active is None else seen.drawn & faces.active
    counts = lax.optimization_barrier(jnp.where(drawn, seen.across * seen.down, 0))
    expanded = expand_one_by_one if (driver or best_driver()) == "loop" else expand
    item, rank, needed = expanded(counts, capacity)

    scale = layout.depth_levels / (depth_range[1] - depth_range[0])
    levels = jnp.clip((screen[2] - depth_range[0]) * scale, 0.0, float(layout.depth_levels)) + 1.0
    item, rank, levels = lax.optimization_barrier((item, rank, levels))
    count = jnp.minimum(needed, capacity)
    listed = WindowList(item, rank, count, needed, faces.corners, faces.numbers, points, levels, size)
    return listed, places


def planned_windows(listed: WindowList, item: Int[Array, "n"], rank: Int[Array, "n"]) -> Windows:
    """Compute the planes of some windows from the corners of each one's face."""
    of_item = lax.optimization_barrier(tuple(look_up(vertices, item) for vertices in listed.faces))
    level = lax.optimization_barrier(tuple(look_up(listed.levels, vertex) for vertex in of_item))
    number = look_up(listed.numbers, item)
    face = _set_up(corner_places(listed.points, of_item), *listed.size)
    (ax, bx, cx), (ay, by, cy) = face.places
    inv_area = jnp.where(face.drawn, 1.0 / jnp.where(face.drawn, face.area, -1.0), 0.0)
    a0, b0 = -(cy - by) * inv_area, (cx - bx) * inv_area
    a1, b1 = -(ay - cy) * inv_area, (ax - cx) * inv_area
    c0, c1 = jnp.where(face.drawn, -(a0 * bx + b0 * by), -1.0), -(a1 * cx + b1 * cy)  # empty if rounding says so
    d0, d1 = level[0] - level[2], level[1] - level[2]
    az, bz, cz = a0 * d0 + a1 * d1, b0 * d0 + b1 * d1, c0 * d0 + c1 * d1 + level[2]

    (first_x, first_y), (skip_x, skip_y), across = face.first, face.skip, jnp.maximum(face.across, 1)
    step_y = ((rank.astype(jnp.float32) + 0.5) / across.astype(jnp.float32)).astype(jnp.int32)  # exact below 2^22
    offset_x, offset_y = (skip_x + rank - step_y * across) * WINDOW, (skip_y + step_y) * WINDOW
    fx, fy = lax.optimization_barrier((offset_x.astype(jnp.float32), offset_y.astype(jnp.float32)))
    planes = (a0, b0, c0 + a0 * fx + b0 * fy, a1, b1, c1 + a1 * fx + b1 * fy, az, bz, cz + az * fx + bz * fy)
    column, row = first_x + offset_x + WINDOW, first_y + offset_y + WINDOW
    # Kept apart, one array each: the loop that draws reads them in turn, and a table would have to be written first.
    return Windows(*lax.optimization_barrier((planes, column, row, number)))


def _window_keys(planes: tuple[Array, ...], face: Int[Array, ""], layout: KeyLayout) -> Int[Array, "8 8 1"]:
    """Compute the keys of a face in a window, 0 where it is not.

    The last axis is there for XLA on a CPU: it unrolls the innermost loop, and of two loops the columns would be
    unrolled and the rows, which lie far apart, become vectors.
    """
    lane_x = jnp.arange(WINDOW, dtype=jnp.float32)[None, :, None]
    lane_y = jnp.arange(WINDOW, dtype=jnp.float32)[:, None, None]
    first, second, level = (c + a * lane_x + b * lane_y for a, b, c in (planes[:3], planes[3:6], planes[6:]))
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
    items, ranks = (jnp.pad(values, (0, missing)) for values in (listed.item, listed.rank))

    def some(chunk: Array, keys: Array) -> Array:
        first = chunk * at_once
        windows = planned_windows(
            listed, *(lax.dynamic_slice(values, (first,), (at_once,)) for values in (items, ranks))
        )

        def one(i: Array, keys: Array) -> Array:
            planes, column, row, face = jax.tree.map(lambda values: look_up(values, i), windows)
            corner = (row + first_row, column, jnp.zeros((), row.dtype))
            old = lax.dynamic_slice(keys, corner, (WINDOW, WINDOW, 1))
            return lax.dynamic_update_slice(keys, jnp.maximum(old, _window_keys(planes, face, layout)), corner)

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
    keys = jax.vmap(lambda planes, face: _window_keys(planes, face, layout)[..., 0])(windows.planes, windows.face)
    live = (jnp.arange(listed.item.shape[0]) < listed.count)[:, None, None]
    lanes = jnp.arange(WINDOW)
    index_x = windows.column[:, None, None] + lanes[None, None, :]
    index_y = first_row + windows.row[:, None, None] + lanes[None, :, None]
    flat = jnp.where(live & (keys > 0), index_y * buffer.shape[1] + index_x, buffer.size)
    return buffer.reshape(-1).at[flat.reshape(-1)].max(keys.reshape(-1), mode="drop").reshape(buffer.shape)
