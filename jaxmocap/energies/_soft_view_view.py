"""Eq. 7 over soft coverage, which has gradients: each face that shares a pixel looks for its own partner."""

from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int

from jaxmocap.appearance import TAU
from jaxmocap.render import SoftFaces, expand

from ._term import SoftDrawn
from ._view_pair import are_near, ordered_pairs, partner_pixels, pixel_transfer, pixels_around

_Seen = tuple[SoftFaces, Float[Array, "3 4"], Int[Array, "2"], Float[Array, "height width 3"]]


class SoftView(NamedTuple):
    """The settings of `ViewView`, but for its weight."""

    step: int
    sampling: Literal["bilinear", "nearest"]
    fail: Literal["tau", "ignore"]
    outside: Literal["tau", "ignore"]


def soft_view_view(drawn: SoftDrawn, how: SoftView) -> Float[Array, ""]:
    """Sum Eq. 7 over ordered pairs of views; near faces count by their share of the partner's pixel."""
    frame = drawn.frame
    pairs = np.array(ordered_pairs(frame.num_cameras), np.int32).reshape(-1, 2)

    def mean(pair: Array) -> Array:
        views = (drawn.seen, frame.projection, frame.origins, frame.image)
        own, other = (jax.tree.map(lambda leaf, c=camera: leaf[c], views) for camera in pair)
        return _mean(own, other, drawn, how)

    return lax.map(mean, jnp.asarray(pairs)).sum() if len(pairs) else jnp.zeros(())


def _mean(own_view: _Seen, other_view: _Seen, drawn: SoftDrawn, how: SoftView) -> Array:
    """Eq. 7 from one view to another: the mean over what is covered in the first of the colour difference."""
    own, own_projection, own_origin, own_image = own_view
    other, other_projection, other_origin, other_image = other_view
    frame, settings, (height, width) = drawn.frame, drawn.settings, drawn.frame.size
    on_grid = (own.pixel // width % how.step == 0) & (own.pixel % width % how.step == 0)
    use = (lax.stop_gradient(own.share) > 0) & on_grid[:, None] & (own.live > 0)[:, None]
    capacity = -(-settings.shares // how.step**2)
    pick, _, count = expand(use.reshape(-1).astype(jnp.int32), capacity)
    live = jnp.arange(capacity) < count
    entry, layer = pick // settings.layers, pick % settings.layers
    share = jnp.where(live, own.share[entry, layer], 0.0)
    pixel, face, inverse = own.pixel[entry], jnp.maximum(own.face[entry, layer], 0), own.inverse_depth[entry, layer]
    source, target = own_origin.astype(jnp.float32) + 0.5, other_origin.astype(jnp.float32) + 0.5
    u, v = (pixel % width).astype(jnp.float32) + source[1], (pixel // width).astype(jnp.float32) + source[0]
    x, y, z = partner_pixels(u, v, inverse, pixel_transfer(own_projection, other_projection))
    x, y = x - target[1], y - target[0]
    inside = (z > 1e-6) & (x >= -0.5) & (y >= -0.5) & (x < width - 0.5) & (y < height - 0.5)
    x, y = jnp.where(inside, x, 0.0), jnp.where(inside, y, 0.0)

    near, colour = jnp.zeros_like(share), jnp.zeros((*share.shape, 3))
    smooth = 1.0 if how.sampling == "bilinear" else settings.width
    for row, column, part, part_of_colour in pixels_around(x, y, settings.width, smooth):
        fits = inside & (row >= 0) & (column >= 0) & (row < height) & (column < width)
        place = jnp.clip(row, 0, height - 1) * width + jnp.clip(column, 0, width - 1)
        slot = other.slot[place]
        there = jnp.minimum(slot, settings.pixels - 1)
        faces = jnp.where((slot < settings.pixels)[:, None], other.face[there], -1)
        agree = (faces >= 0) & are_near(frame.surface.near_faces, face[:, None], jnp.maximum(faces, 0))
        near += part * jnp.where(fits, jnp.where(agree, other.share[there], 0.0).sum(1), 0.0)
        colour += part_of_colour[:, None] * other_image.reshape(-1, 3)[place]
    difference = ((own_image.reshape(-1, 3)[pixel] - colour) ** 2).sum(-1)
    distance = jnp.where(difference > 0, jnp.sqrt(jnp.where(difference > 0, difference, 1.0)), 0.0)
    cost = jnp.minimum(distance, TAU)
    failed = jnp.where(inside, float(how.fail == "tau"), float(how.outside == "tau"))
    paid = (share * (near * cost + (1.0 - near) * failed * TAU)).sum()
    counted = (share * (near + (1.0 - near) * failed)).sum()
    return jnp.where(counted > 0, paid / jnp.where(counted > 0, counted, 1.0), TAU)
