"""Huber's robust penalty and its weight."""

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float


def huber(residual: Float[Array, "*shape"], scale: ArrayLike) -> Float[Array, "*shape"]:
    """Compute Huber's loss (1964): e^2 up to `scale`, then `2 s |e| - s^2`."""
    size = jnp.abs(residual)
    return jnp.where(size <= scale, jnp.square(residual), 2 * jnp.asarray(scale) * size - jnp.square(scale))


def huber_weight(residual: Float[Array, "*shape"], scale: ArrayLike) -> Float[Array, "*shape"]:
    """Compute the weight w with `d(w e^2) = d huber(e)` while w is held: `min(1, s / |e|)`."""
    return jnp.asarray(scale) / jnp.maximum(jnp.abs(residual), scale)
