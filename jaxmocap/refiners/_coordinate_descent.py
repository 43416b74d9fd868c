"""Shooting: coordinate descent for least squares with an L1 term and a box."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float, Int


def shooting(
    hessian: Float[Array, "dof dof"],
    gradient: Float[Array, "dof"],
    l1: Float[Array, "*dof"] | float,
    lower: Float[Array, "dof"],
    upper: Float[Array, "dof"],
    start: Float[Array, "dof"],
    sweeps: int = 100,
    tolerance: ArrayLike = 1e-8,
) -> Float[Array, "dof"]:
    """Fu, Journal of Computational and Graphical Statistics 7, 1998, with limits (Eq. 10's solver).

    Minimises `delta^T H delta - 2 g^T delta + sum_j l1_j |delta_j|` in [lower, upper] by exact cyclic coordinate steps

        rho_j = g_j - sum_{k != j} H_jk delta_k
        delta_j = clip(sign(rho_j) max(|rho_j| - l1_j / 2, 0) / H_jj, lower_j, upper_j)

    until no coordinate changes by more than `tolerance`, at most `sweeps` times. The threshold is l1 / 2 because the
    quadratic is not halved. A coordinate with H_jj = 0 keeps its start.
    """
    size = start.shape[0]
    l1 = jnp.broadcast_to(jnp.asarray(l1, start.dtype), (size,))
    diagonal = jnp.diagonal(hessian)
    inverse = jnp.where(diagonal > 0, 1 / jnp.where(diagonal > 0, diagonal, 1.0), 0.0)

    def coordinate(j: Int[Array, ""], carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        delta, remainder, change = carry  # remainder = g - H delta
        rho = remainder[j] + diagonal[j] * delta[j]
        shrunk = jnp.sign(rho) * jnp.maximum(jnp.abs(rho) - 0.5 * l1[j], 0.0) * inverse[j]
        moved = jnp.where(diagonal[j] > 0, jnp.clip(shrunk, lower[j], upper[j]), delta[j])
        step = moved - delta[j]
        return delta.at[j].set(moved), remainder - step * hessian[j], jnp.maximum(change, jnp.abs(step))

    def sweep(carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        count, delta, _ = carry
        remainder = gradient - jnp.matmul(hessian, delta, precision="highest")
        delta, _, change = jax.lax.fori_loop(0, size, coordinate, (delta, remainder, jnp.zeros((), delta.dtype)))
        return count + 1, delta, change

    def unfinished(carry: tuple[Array, Array, Array]) -> Array:
        count, _, change = carry
        return (count < sweeps) & (change > tolerance)

    first = (jnp.zeros((), jnp.int32), jnp.clip(start, lower, upper), jnp.full((), jnp.inf, start.dtype))
    return jax.lax.while_loop(unfinished, sweep, first)[1]
