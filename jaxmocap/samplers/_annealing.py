"""The parts of annealing: how sharply energies turn into weights, and weights into indices."""

from typing import Literal

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from jaxmocap._types import Knob

from ._base import effective_sample_size

Schedule = Literal["ess", "poly_std", "poly_raw"]

BETA_MIN, BETA_MAX = 1e-2, 1e7
"""They fit energies that differ by 1e-7 to 1e2."""


def energy_gaps(energies: Float[Array, "particle"]) -> Float[Array, "particle"]:
    """Subtract the lowest energy; +inf where not finite; all zero if no energy is finite."""
    finite = jnp.isfinite(energies)
    lowest = jnp.min(jnp.where(finite, energies, jnp.inf))
    known = jnp.where(finite, energies, 0.0)
    gaps = jnp.where(finite, known - jnp.where(jnp.any(finite), lowest, 0.0), jnp.inf)
    return jnp.where(jnp.any(finite), gaps, jnp.zeros_like(gaps))


def boltzmann_weights(gaps: Float[Array, "particle"], beta: Float[Array, ""]) -> Float[Array, "particle"]:
    """Compute `exp(-beta (V - V_min))`; the best particle has weight 1, an infinite energy has weight 0."""
    return jnp.where(jnp.isfinite(gaps), jnp.exp(-beta * jnp.where(jnp.isfinite(gaps), gaps, 0.0)), 0.0)


def beta_for_effective_sample_size(gaps: Float[Array, "particle"], share: Knob) -> Float[Array, ""]:
    """Find by bisection the beta of effective sample size `share * N` (survival rate, Deutscher and Reid, IJCV 2005).

    The effective sample size falls as beta grows, so 40 halvings of [`BETA_MIN`, `BETA_MAX`] suffice. Where even
    `BETA_MAX` selects too little (energies all equal), `BETA_MAX` is returned.
    """
    target = share * gaps.shape[0]

    def halve(_: Int[Array, ""], bracket: tuple[Array, Array]) -> tuple[Array, Array]:
        low, high = bracket
        middle = 0.5 * (low + high)
        too_many = effective_sample_size(boltzmann_weights(gaps, jnp.exp(middle))) > target
        return jnp.where(too_many, middle, low), jnp.where(too_many, high, middle)

    ends = (jnp.log(BETA_MIN).astype(gaps.dtype), jnp.log(BETA_MAX).astype(gaps.dtype))
    _, high = jax.lax.fori_loop(0, 40, halve, ends)
    return jnp.exp(high)


def energy_scale(gaps: Float[Array, "particle"]) -> Float[Array, ""]:
    """Compute the standard deviation of the finite energies; 1 where they are all equal."""
    finite = jnp.isfinite(gaps)
    count = jnp.maximum(jnp.sum(finite), 1)
    known = jnp.where(finite, gaps, 0.0)
    mean = jnp.sum(known) / count
    deviation = jnp.sqrt(jnp.sum(jnp.where(finite, (known - mean) ** 2, 0.0)) / count)
    return jnp.where(deviation > 0, deviation, 1.0)


def _inverse_distribution(
    weights: Float[Array, "particle"], positions: Float[Array, "particle"]
) -> Int[Array, "particle"]:
    """Find where the cumulative weights pass `positions` in [0, 1); a particle of weight zero is never chosen."""
    cumulative = jnp.cumsum(weights)
    last_possible = weights.shape[0] - 1 - jnp.argmax(weights[::-1] > 0)
    indices = jnp.searchsorted(cumulative, positions * cumulative[-1], side="right")
    return jnp.minimum(indices, last_possible)


def multinomial(
    key: PRNGKeyArray, weights: Float[Array, "particle"], redrawn: Bool[Array, "particle"]
) -> Int[Array, "particle"]:
    """Draw independently in proportion to the weights; particles that are not `redrawn` keep their index."""
    positions = jax.random.uniform(key, weights.shape, weights.dtype)
    return jnp.where(redrawn, _inverse_distribution(weights, positions), jnp.arange(weights.shape[0]))


def systematic(
    key: PRNGKeyArray, weights: Float[Array, "particle"], redrawn: Bool[Array, "particle"]
) -> Int[Array, "particle"]:
    """Draw by one random offset and equal steps over the redrawn particles.

    There is less noise than in `multinomial`, and the same expectation.
    """
    rank = jnp.cumsum(redrawn) - 1
    offset = jax.random.uniform(key, (), weights.dtype)
    positions = jnp.where(redrawn, (rank + offset) / jnp.maximum(jnp.sum(redrawn), 1), 0.0)
    return jnp.where(redrawn, _inverse_distribution(weights, positions), jnp.arange(weights.shape[0]))
