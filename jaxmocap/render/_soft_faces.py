"""The soft rasteriser: which faces share each pixel, and how much of it each of them shows.

A pixel is a square of `width` pixels. Every face covers an exact area of it (`covered_area`), and from front to back
each face shows what those in front have left over: faces of one surface tile the square, so inside a surface nothing of
what lies behind comes through, at its outline exactly the right share does, and as the width goes to zero this is the
z-buffer. The order of the faces is found by an integer z-buffer of several layers, through which nothing is
differentiated; the shares are, with respect to everything that moves the vertices.
"""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from jaxmocap._types import Knob, knob

from ._coverage import covered_area
from ._expand import corner, expand
from ._keys import WINDOW, KeyLayout, crop
from ._windows import FARTHEST_PIXEL


class SoftSettings(eqx.Module):
    """How wide the soft rasteriser sees, and room for it; `SoftFaces.needed` says how much there should have been.

    Attributes:
        width: of a pixel's square, pixels: 1 is a camera's pixel, larger ones reach further, 0 in the limit is the hard
            rasteriser.
        layers: faces that may share a pixel.
        windows: windows of 8 x 8 pixels of one view at most.
        pixels: pixels of one view that anything covers at most.
        shares: pairs of pixel and face of one view at most.
    """

    width: Knob = knob(1.0)
    layers: int = eqx.field(static=True, default=12)
    windows: int = eqx.field(static=True, default=16384)
    pixels: int = eqx.field(static=True, default=65536)
    shares: int = eqx.field(static=True, default=131072)


class SoftFaces(NamedTuple):
    """What is seen in one view, as a list of pixels.

    `pixel` counts row by row, `live` says which entries are used, `slot` is each pixel's place in the list (or its
    length). `face` is -1 where fewer faces share the pixel, `share` its part of the pixel, `inverse_depth` (1/metres)
    that of its plane at the centre. `needed` are windows, pixels and shares.
    """

    pixel: Int[Array, "entry"]
    live: Float[Array, "entry"]
    slot: Int[Array, "pixel"]
    face: Int[Array, "entry layer"]
    share: Float[Array, "entry layer"]
    inverse_depth: Float[Array, "entry layer"]
    needed: Int[Array, "3"]


def _as_float(value: Int[Array, "*n"]) -> Float[Array, "*n"]:
    return lax.bitcast_convert_type(value.astype(jnp.int32), jnp.float32)


def _as_int(value: Float[Array, "*n"]) -> Int[Array, "*n"]:
    return lax.bitcast_convert_type(value, jnp.int32)


def _windows(
    screen: Float[Array, "3 vertex"],
    faces: Int[Array, "3 face"],
    height: int,
    width_pixels: int,
    reach: Knob,
    depth_range: Float[Array, "2"],
    layout: KeyLayout,
    capacity: int,
) -> tuple[Float[Array, "window 14"], Int[Array, ""], Int[Array, ""]]:
    """Windows of all front faces that come within `reach` pixels of a pixel centre."""
    x, y, inverse = screen[0][faces], screen[1][faces], screen[2][faces]
    first_x, last_x = jnp.ceil(x.min(0) - reach), jnp.floor(x.max(0) + reach)
    first_y, last_y = jnp.ceil(y.min(0) - reach), jnp.floor(y.max(0) + reach)
    area = (x[1] - x[0]) * (y[2] - y[0]) - (y[1] - y[0]) * (x[2] - x[0])
    seen = (
        (inverse.min(0) > 0)
        & (jnp.abs(x).max(0) < FARTHEST_PIXEL)
        & (jnp.abs(y).max(0) < FARTHEST_PIXEL)
        & (area < -1e-8)
    )
    seen &= (last_x >= 0) & (last_y >= 0) & (first_x <= width_pixels - 1) & (first_y <= height - 1)
    seen &= (last_x >= first_x) & (last_y >= first_y)

    def whole(value: Array, low: int, high: int) -> Array:
        return jnp.clip(jnp.where(seen, value, 0.0).astype(jnp.int32), low, high)

    left, right = whole(first_x, 0, width_pixels - 1), whole(last_x, 0, width_pixels - 1)
    top, bottom = whole(first_y, 0, height - 1), whole(last_y, 0, height - 1)
    across = jnp.where(seen, (right - left) // WINDOW + 1, 0)
    item, rank, needed = expand(across * ((bottom - top) // WINDOW + 1), capacity)
    scale = layout.depth_levels / (depth_range[1] - depth_range[0])
    level = jnp.clip((inverse - depth_range[0]) * scale, 0.0, float(layout.depth_levels)) + 1.0
    planes = _plane(x, y, level)
    table = jnp.stack(
        [*x, *y, *planes, level.min(0), level.max(0), *(_as_float(v) for v in (left, top, jnp.maximum(across, 1)))],
        axis=1,
    )[item]
    step = rank // _as_int(table[:, 13])
    column = _as_int(table[:, 11]) + (rank - step * _as_int(table[:, 13])) * WINDOW
    row = _as_int(table[:, 12]) + step * WINDOW
    records = jnp.concatenate(
        [table[:, :11], jnp.stack([_as_float(column), _as_float(row), _as_float(item)], axis=1)], axis=1
    )
    return records, jnp.minimum(needed, capacity), needed


def _plane(x: Array, y: Array, value: Array) -> tuple[Array, Array, Array]:
    """Compute a, b, c of value = a x + b y + c through three corners; flat where they are in line."""
    area = (x[1] - x[0]) * (y[2] - y[0]) - (y[1] - y[0]) * (x[2] - x[0])
    inv = jnp.where(jnp.abs(area) > 1e-6, 1.0, 0.0) / jnp.where(jnp.abs(area) > 1e-6, area, 1.0)
    d1, d2 = value[1] - value[0], value[2] - value[0]
    a = (d1 * (y[2] - y[0]) - d2 * (y[1] - y[0])) * inv
    b = (d2 * (x[1] - x[0]) - d1 * (x[2] - x[0])) * inv
    return a, b, value[0] - a * x[0] - b * y[0]


def _layers(
    screen: Float[Array, "3 vertex"],
    faces: Int[Array, "3 face"],
    height: int,
    width: int,
    depth_range: Float[Array, "2"],
    layout: KeyLayout,
    settings: SoftSettings,
) -> tuple[Int[Array, "layer height width"], Int[Array, ""]]:
    """Keys (layer, height, width) of the nearest faces that touch each pixel's square, nearest first."""
    reach = 0.5 * settings.width
    records, count, needed = _windows(screen, faces, height, width, reach, depth_range, layout, settings.windows)
    column, row, face = (_as_int(records[:, k]) for k in (11, 12, 13))
    lane = jnp.arange(WINDOW)
    shape = (records.shape[0], WINDOW, WINDOW)
    at_x = jnp.broadcast_to((column[:, None] + lane).astype(jnp.float32)[:, None, :], shape)
    at_y = jnp.broadcast_to((row[:, None] + lane).astype(jnp.float32)[:, :, None], shape)
    numbers = records.T[:, :, None, None]
    touched = covered_area(numbers[0:3] - at_x, numbers[3:6] - at_y, settings.width) > 0
    level = jnp.clip(numbers[6] * at_x + numbers[7] * at_y + numbers[8], numbers[9], numbers[10])
    keys = jnp.where(touched, (level.astype(jnp.int32) << layout.id_bits) | face[:, None, None], 0)

    def insert(i: Array, buffer: Array) -> Array:
        start = corner(0, row[i] + WINDOW, column[i] + WINDOW)
        old = lax.dynamic_slice(buffer, start, (settings.layers, WINDOW, WINDOW))
        nearer = jnp.concatenate([jnp.full((1, WINDOW, WINDOW), jnp.iinfo(jnp.int32).max), old[:-1]])
        return lax.dynamic_update_slice(buffer, jnp.maximum(old, jnp.minimum(nearer, keys[i])), start)

    empty = jnp.zeros((settings.layers, height + 2 * WINDOW, width + 2 * WINDOW), jnp.int32)
    return crop(lax.fori_loop(0, count, insert, empty)), needed


def soft_faces(
    screen: Float[Array, "3 vertex"],
    faces: Int[Array, "3 face"],
    height: int,
    width: int,
    depth_range: Float[Array, "2"],
    settings: SoftSettings | None = None,
) -> SoftFaces:
    """Find the faces that share each pixel of a rectangle, and their shares, which sum to at most one.

    `screen` is what `to_screen` returns. Where more than `layers` faces share a pixel the nearest ones share all of it.
    """
    settings = SoftSettings() if settings is None else settings
    depth_range = depth_range.astype(jnp.float32)
    layout = KeyLayout.for_faces(faces.shape[1])
    fixed = lax.stop_gradient((screen, depth_range))
    keys, windows = _layers(fixed[0], faces, height, width, fixed[1], layout, lax.stop_gradient(settings))
    touched = (keys[0] > 0).reshape(-1)
    pixel, _, pixels = expand(touched.astype(jnp.int32), settings.pixels)
    entries = jnp.arange(settings.pixels)
    live = entries < pixels
    slot = (
        jnp.full(height * width, settings.pixels, jnp.int32)
        .at[jnp.where(live, pixel, height * width)]
        .set(entries.astype(jnp.int32), mode="drop")
    )
    found = keys.reshape(settings.layers, -1)[:, pixel].T
    face = jnp.where(live[:, None] & (found > 0), found & layout.id_mask, -1)
    used = (face >= 0).reshape(-1)
    pick, _, shares = expand(used.astype(jnp.int32), settings.shares)
    pick = jnp.where(jnp.arange(settings.shares) < shares, pick, used.shape[0])
    entry = jnp.minimum(pick // settings.layers, settings.pixels - 1)
    corners = screen[:, faces].reshape(9, -1).T[jnp.maximum(face.reshape(-1)[pick], 0)].T
    x = corners[0:3] - (pixel[entry] % width).astype(jnp.float32)
    y = corners[3:6] - (pixel[entry] // width).astype(jnp.float32)
    inverse = corners[6:9]
    at_centre = jnp.clip(_plane(x, y, inverse)[2], inverse.min(0), inverse.max(0))

    def spread(values: Float[Array, "share"]) -> Float[Array, "entry layer"]:
        return jnp.zeros(used.shape[0]).at[pick].set(values, mode="drop", unique_indices=True).reshape(face.shape)

    area = spread(covered_area(x, y, settings.width))
    before = jnp.cumsum(area, axis=1) - area
    share = jnp.minimum(area, jnp.maximum(1.0 - before, 0.0))
    crowded = (face[:, -1:] >= 0) & (share.sum(1, keepdims=True) > 0)
    share = jnp.where(crowded, share / jnp.where(crowded, share.sum(1, keepdims=True), 1.0), share)
    return SoftFaces(
        pixel, live.astype(jnp.float32), slot, face, share, spread(at_centre), jnp.stack([windows, pixels, shares])
    )
