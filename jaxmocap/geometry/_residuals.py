"""What residuals are made of: distances from lines in Pluecker coordinates (Eq. 9), and robust penalties."""

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float


def pluecker_line(
    centre: Float[Array, "*batch 3"], direction: Float[Array, "*batch 3"]
) -> tuple[Float[Array, "*batch 3"], Float[Array, "*batch 3"]]:
    """Represent the line through `centre` along `direction` by unit direction n and moment m = centre x n (metres).

    Leading axes broadcast: one camera centre with many viewing rays gives one line per ray.
    """
    normal = direction / jnp.linalg.norm(direction, axis=-1, keepdims=True)
    return normal, jnp.cross(jnp.broadcast_to(centre, normal.shape), normal)


def point_line_residual(
    point: Float[Array, "*batch 3"], n: Float[Array, "*batch 3"], m: Float[Array, "*batch 3"]
) -> Float[Array, "*batch 3"]:
    """Compute Eq. 9's residual e = v x n - m.

    It is zero on the line, and |e| is the distance of the point from it in metres.
    """
    return jnp.cross(point, n) - m


def geman_mcclure(residual: Float[Array, "*shape"], scale: ArrayLike) -> Float[Array, "*shape"]:
    """Compute `s^2 e^2 / (s^2 + e^2)` (Geman and McClure, 1987): e^2 for small residuals, never more than s^2."""
    squared, ceiling = jnp.square(residual), jnp.square(jnp.asarray(scale))
    return ceiling * squared / (ceiling + squared)


def geman_mcclure_weight(residual: Float[Array, "*shape"], scale: ArrayLike) -> Float[Array, "*shape"]:
    """Weight w with `d(w e^2) = d geman_mcclure(e)` while w is held: `(s^2 / (s^2 + e^2))^2`."""
    ceiling = jnp.square(jnp.asarray(scale))
    return jnp.square(ceiling / (ceiling + jnp.square(residual)))


def huber(residual: Float[Array, "*shape"], scale: ArrayLike) -> Float[Array, "*shape"]:
    """Compute Huber's loss (1964): e^2 up to `scale`, then `2 s |e| - s^2`."""
    size = jnp.abs(residual)
    return jnp.where(size <= scale, jnp.square(residual), 2 * jnp.asarray(scale) * size - jnp.square(scale))


def huber_weight(residual: Float[Array, "*shape"], scale: ArrayLike) -> Float[Array, "*shape"]:
    """Weight w with `d(w e^2) = d huber(e)` while w is held: `min(1, s / |e|)`."""
    return jnp.asarray(scale) / jnp.maximum(jnp.abs(residual), scale)
