"""Two views of one surface point: where what one view sees appears in the other, and whether they see the same."""

from collections.abc import Iterator
from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from jaxmocap._types import Knob
from jaxmocap.geometry import inverse
from jaxmocap.observation import FrameProblem
from jaxmocap.render import look_up


def ordered_pairs(num_cameras: int) -> list[tuple[int, int]]:
    """List all (m, n) with m != n: E_mn is not symmetric (ambiguity A16 of the equation, read as ordered pairs)."""
    return [(m, n) for m in range(num_cameras) for n in range(num_cameras) if m != n]


class PixelTransfer(NamedTuple):
    """What takes (column, row, 1) and inverse depth of the source view to the homogeneous pixel of the target: the
    homography of the plane at infinity, and the epipole (Hartley and Zisserman 2004, sec. 13.1)."""

    homography: Float[Array, "3 3"]
    epipole: Float[Array, "3"]


def pixel_transfer(source: Float[Array, "3 4"], target: Float[Array, "3 4"]) -> PixelTransfer:
    """Build the transfer of pixels from the projections of the two views."""
    homography = jnp.matmul(target[:, :3], inverse(source[:, :3]), precision="highest")
    return PixelTransfer(homography, target[:, 3] - jnp.matmul(homography, source[:, 3], precision="highest"))


def partner_pixels(
    columns: Array, rows: Array, inverse_depth: Array, between: PixelTransfer
) -> tuple[Array, Array, Array]:
    """Transfer surface points seen at pixels (column, row) of the source view, at this inverse depth, to the target.

    Exact: inverse depth is affine over a face, so this is the ray cut with the face's plane. Returns column, row and
    the scaled depth (positive in front of the target camera).
    """
    h, e = between
    x, y, z = (h[k, 0] * columns + h[k, 1] * rows + h[k, 2] + e[k] * inverse_depth for k in range(3))
    safe = jnp.where(z > 1e-6, z, 1.0)
    return x / safe, y / safe, z


def partner_in_rectangle(
    frame: FrameProblem,
    between: PixelTransfer,
    inverse_depth: Array,
    rows: Array,
    columns: Array,
    m: int | Array,
    n: int | Array,
) -> tuple[Array, Array, Array]:
    """Find column and row in view n's rectangle of pixels of view m's, and whether the nearest pixel lies inside it."""
    origin, target = frame.origins[m], frame.origins[n]
    u = columns + (origin[1].astype(jnp.float32) + 0.5)
    v = rows + (origin[0].astype(jnp.float32) + 0.5)
    x, y, z = partner_pixels(u, v, inverse_depth, between)
    x, y = x - (target[1].astype(jnp.float32) + 0.5), y - (target[0].astype(jnp.float32) + 0.5)
    height, width = frame.size
    inside = (z > 1e-6) & (x >= -0.5) & (y >= -0.5) & (x < width - 0.5) & (y < height - 0.5)
    return jnp.where(inside, x, 0.0), jnp.where(inside, y, 0.0), inside


def are_near(near_faces: Array, first: Int[Array, "..."], second: Int[Array, "..."]) -> Bool[Array, "..."]:
    """Test by the bit table whether faces are geodesically near (Eq. 7); the two broadcast."""
    words = look_up(near_faces.reshape(-1), first * near_faces.shape[1] + (second >> 5))
    return ((words >> (second & 31).astype(jnp.uint32)) & 1) == 1


def pixels_around(
    x: Array, y: Array, width: Knob, width_of_colour: Knob
) -> Iterator[tuple[Array, Array, Array, Array]]:
    """Yield the four pixels around a point: row, column, weight of what is seen there, weight of its colour.

    The weights blend over `width` and `width_of_colour` pixels: 1 is bilinear, 0 the nearest pixel.
    """
    left, top = jnp.floor(lax.stop_gradient(x)), jnp.floor(lax.stop_gradient(y))

    def blend(fraction: Array, over: float | Array) -> Array:
        return jnp.clip((fraction - 0.5) / jnp.minimum(over, 1.0) + 0.5, 0.0, 1.0)

    for down in (0, 1):
        for right in (0, 1):
            weights = []
            for over in (width, width_of_colour):
                fx, fy = blend(x - left, over), blend(y - top, over)
                weights.append((fx if right else 1 - fx) * (fy if down else 1 - fy))
            yield (top + down).astype(jnp.int32), (left + right).astype(jnp.int32), *weights
