"""Plain functions from weights to indices."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray


def effective_sample_size(weights: Float[Array, "particle"]) -> Float[Array, ""]:
    """`(sum w)^2 / sum w^2`: how many equally weighted particles the set is worth."""
    return jnp.sum(weights) ** 2 / jnp.sum(weights**2)


def _inverse_distribution(
    weights: Float[Array, "particle"], positions: Float[Array, "particle"]
) -> Int[Array, "particle"]:
    """Indices where the cumulative weights pass `positions` in [0, 1); a particle of weight zero is never chosen."""
    cumulative = jnp.cumsum(weights)
    last_possible = weights.shape[0] - 1 - jnp.argmax(weights[::-1] > 0)
    indices = jnp.searchsorted(cumulative, positions * cumulative[-1], side="right")
    return jnp.minimum(indices, last_possible)


def multinomial(
    key: PRNGKeyArray, weights: Float[Array, "particle"], redrawn: Bool[Array, "particle"]
) -> Int[Array, "particle"]:
    """Independent draws in proportion to the weights; particles that are not `redrawn` keep their index."""
    positions = jax.random.uniform(key, weights.shape, weights.dtype)
    return jnp.where(redrawn, _inverse_distribution(weights, positions), jnp.arange(weights.shape[0]))


def systematic(
    key: PRNGKeyArray, weights: Float[Array, "particle"], redrawn: Bool[Array, "particle"]
) -> Int[Array, "particle"]:
    """One random offset and equal steps over the redrawn particles: less noise than `multinomial`, same expectation."""
    rank = jnp.cumsum(redrawn) - 1
    offset = jax.random.uniform(key, (), weights.dtype)
    positions = jnp.where(redrawn, (rank + offset) / jnp.maximum(jnp.sum(redrawn), 1), 0.0)
    return jnp.where(redrawn, _inverse_distribution(weights, positions), jnp.arange(weights.shape[0]))
