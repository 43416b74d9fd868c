"""Keeping particles inside a box without piling them up on its walls."""

import jax.numpy as jnp
from jaxtyping import Array, Float


def reflect(
    particles: Float[Array, "*batch dof"], lower: Float[Array, "dof"], upper: Float[Array, "dof"]
) -> Float[Array, "*batch dof"]:
    """Fold values back at the limits, as often as needed. Clipping would collect particles on the wall.

    Infinite limits are allowed on either side; equal limits pin the value.
    """
    two_sided = jnp.isfinite(lower) & jnp.isfinite(upper)
    width = jnp.where(two_sided, upper - lower, 1.0)
    safe_width = jnp.where(width > 0, width, 1.0)
    low = jnp.where(jnp.isfinite(lower), lower, 0.0)
    high = jnp.where(jnp.isfinite(upper), upper, 0.0)
    phase = jnp.mod(particles - low, 2 * safe_width)
    folded = low + jnp.where(phase > safe_width, 2 * safe_width - phase, phase)
    above = jnp.where(jnp.isfinite(lower), low + jnp.abs(particles - low), particles)
    one_sided = jnp.where(jnp.isfinite(upper), high - jnp.abs(high - particles), above)
    inside = (particles >= lower) & (particles <= upper)
    return jnp.clip(jnp.where(inside, particles, jnp.where(two_sided, folded, one_sided)), lower, upper)
