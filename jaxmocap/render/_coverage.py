"""How much of a pixel a triangle covers: the exact area of a triangle in a square, differentiable in its corners."""

import jax.numpy as jnp
from jaxtyping import Array, Float

_FLAT = 1e-3


def _mean_height(first: Float[Array, "*n"], last: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """Average y, clipped to [0, 1], while it goes from `first` to `last`."""
    low, high = jnp.minimum(first, last), jnp.maximum(first, last)
    span = high - low
    low_in, high_in = jnp.clip(low, 0.0, 1.0), jnp.clip(high, 0.0, 1.0)
    area = 0.5 * (high_in - low_in) * (high_in + low_in) + jnp.maximum(high, 1.0) - jnp.maximum(low, 1.0)
    steep = span > _FLAT
    return jnp.where(steep, area / jnp.where(steep, span, 1.0), jnp.clip(0.5 * (low + high), 0.0, 1.0))


def _below(x0: Array, y0: Array, x1: Array, y1: Array) -> Float[Array, "*n"]:
    """Signed area between an edge and y = 0 inside the unit square."""
    run = x1 - x0
    safe = jnp.where(jnp.abs(run) > 1e-6, run, 1.0)
    left, right = jnp.clip(x0, 0.0, 1.0), jnp.clip(x1, 0.0, 1.0)
    start, end = jnp.clip((left - x0) / safe, 0.0, 1.0), jnp.clip((right - x0) / safe, 0.0, 1.0)
    rise = y1 - y0
    return (right - left) * _mean_height(y0 + start * rise, y0 + end * rise)


def covered_area(
    corners_x: Float[Array, "3 *n"], corners_y: Float[Array, "3 *n"], width: float | Float[Array, ""]
) -> Float[Array, "*n"]:
    """Measure the share in [0, 1] of the square of `width` pixels around the origin that lies inside a triangle.

    Corners are in pixels from the centre of the square. The shares of triangles that tile the plane add up to one, and
    the share tends to "the centre is inside" as the width goes to zero. The area is that of Green's theorem: each edge
    adds the area between itself and the square's lower side.
    """
    x, y = corners_x / width + 0.5, corners_y / width + 0.5
    area = sum(_below(x[i], y[i], x[(i + 1) % 3], y[(i + 1) % 3]) for i in range(3))
    return jnp.clip(jnp.abs(area), 0.0, 1.0)
