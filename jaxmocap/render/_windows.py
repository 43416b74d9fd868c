"""The hard rasteriser's first half: faces -> 8 x 8 windows, with the planes from which their keys follow.

Each front face is cut into windows on a grid that starts at its own bounding box, so that a window's numbers do not
depend on the rectangle being drawn and a limb drawn over a body gives the same bits as both drawn together. One
vectorised pass over the faces counts their windows; the windows that there are get their planes from the corners of
their faces.
"""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Complex, Float, Int

from ._expand import Driver, best_driver, expand, expand_one_by_one, look_up
from ._keys import WINDOW, KeyLayout

FARTHEST_PIXEL = 30000.0
"""Column or row beyond which a face is not drawn."""
BEHIND = 1e6
"""Column and row of a vertex behind the camera: beyond all that is drawn, and finite."""

Places = tuple[tuple[Float[Array, "n"], ...], tuple[Float[Array, "n"], ...]]
"""Columns and rows of the three corners of faces."""


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

    An inverse depth <= 0 is behind the camera. What is projected in double precision is rounded to single afterwards,
    which is what the rasterisers take.
    """
    places = vertices.T
    column, row, depth = (sum(line[k] * places[k] for k in range(3)) + line[3] for line in projection)
    inverse = jnp.where(depth > 1e-3, 1.0 / jnp.maximum(depth, 1e-3), -1.0)
    column = column * jnp.abs(inverse) - (origin[1].astype(jnp.float32) + 0.5)
    row = row * jnp.abs(inverse) - (origin[0].astype(jnp.float32) + 0.5)
    return jnp.stack([column, row, inverse]).astype(jnp.float32)


def _in_windows(pixels: Int[Array, "*n"]) -> Int[Array, "*n"]:
    """Whole windows in so many pixels, rounded down. XLA divides integers one by one, and guards each division."""
    return pixels >> (WINDOW.bit_length() - 1)


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


def rounded(product: Float[Array, "*n"], zero: Int[Array, ""] | None) -> Float[Array, "*n"]:
    """Keep a product apart from the sum it goes into, by a zero of which no compiler can know that it is one.

    Compilers make one multiply-add of the two, or leave them, as suits each program; the last bit would follow.
    """
    if zero is None:
        return product
    return lax.bitcast_convert_type(lax.bitcast_convert_type(product, jnp.int32) ^ zero, jnp.float32)


def doubled_area(places: Places, zero: Int[Array, ""] | None = None) -> Float[Array, "face"]:
    """Compute twice the area of every face on the screen, negative for front faces; by `zero` the same in every
    program (see `rounded`)."""
    (ax, bx, cx), (ay, by, cy) = places
    return rounded((bx - ax) * (cy - ay), zero) - rounded((by - ay) * (cx - ax), zero)


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


def _set_up(places: Places, height: int, width: int, zero: Int[Array, ""] | None = None) -> _Setup:
    (low_x, high_x), (low_y, high_y) = (
        (jnp.minimum(jnp.minimum(a, b), c), jnp.maximum(jnp.maximum(a, b), c)) for a, b, c in places
    )
    start_x, start_y, last_x, last_y = jnp.ceil(low_x), jnp.ceil(low_y), jnp.floor(high_x), jnp.floor(high_y)
    near = (jnp.minimum(low_x, low_y) > -FARTHEST_PIXEL) & (jnp.maximum(high_x, high_y) < FARTHEST_PIXEL)
    hit = (last_x >= 0) & (last_y >= 0) & (start_x <= width - 1) & (start_y <= height - 1)
    hit &= (last_x >= start_x) & (last_y >= start_y)
    moved = (tuple(x - start_x for x in places[0]), tuple(y - start_y for y in places[1]))
    area = doubled_area(moved, zero)
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
    depth_range = depth_range.astype(jnp.float32)
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


def opaque_zero(listed: WindowList) -> Int[Array, ""]:
    """Make the zero of `rounded`, from the number of windows."""
    return jnp.minimum(listed.count, 0)


def planned_windows(listed: WindowList, item: Int[Array, "n"], rank: Int[Array, "n"]) -> Windows:
    """Compute the planes of some windows from the corners of each one's face."""
    of_item = lax.optimization_barrier(tuple(look_up(vertices, item) for vertices in listed.faces))
    level = lax.optimization_barrier(tuple(look_up(listed.levels, vertex) for vertex in of_item))
    number = look_up(listed.numbers, item)
    zero = opaque_zero(listed)
    face = _set_up(corner_places(listed.points, of_item), *listed.size, zero)
    (ax, bx, cx), (ay, by, cy) = face.places
    inv_area = jnp.where(face.drawn, 1.0 / jnp.where(face.drawn, face.area, -1.0), 0.0)
    a0, b0 = -(cy - by) * inv_area, (cx - bx) * inv_area
    a1, b1 = -(ay - cy) * inv_area, (ax - cx) * inv_area
    d0, d1 = level[0] - level[2], level[1] - level[2]

    def sum_of(a: Array, x: Array, b: Array, y: Array) -> Array:
        return rounded(a * x, zero) + rounded(b * y, zero)

    c0 = jnp.where(face.drawn, -sum_of(a0, bx, b0, by), -1.0)  # empty if rounding says so
    c1 = -sum_of(a1, cx, b1, cy)
    az, bz, cz = sum_of(a0, d0, a1, d1), sum_of(b0, d0, b1, d1), sum_of(c0, d0, c1, d1) + level[2]

    (first_x, first_y), (skip_x, skip_y), across = face.first, face.skip, jnp.maximum(face.across, 1)
    step_y = ((rank.astype(jnp.float32) + 0.5) / across.astype(jnp.float32)).astype(jnp.int32)  # exact below 2^22
    offset_x, offset_y = (skip_x + rank - step_y * across) * WINDOW, (skip_y + step_y) * WINDOW
    fx, fy = lax.optimization_barrier((offset_x.astype(jnp.float32), offset_y.astype(jnp.float32)))
    c0, c1, cz = (c + sum_of(a, fx, b, fy) for a, b, c in ((a0, b0, c0), (a1, b1, c1), (az, bz, cz)))
    column, row = first_x + offset_x + WINDOW, first_y + offset_y + WINDOW
    # Kept apart, one array each: the loop that draws reads them in turn, and a table would have to be written first.
    return Windows(*lax.optimization_barrier(((a0, b0, c0, a1, b1, c1, az, bz, cz), column, row, number)))
