"""Gauss-Newton with shooting inside: coordinate descent for least squares with an L1 term and a box."""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Bool, Float, Int

from jaxmocap._types import Knob, knob

from ._problem import AbstractRefiner, Refined, RefineProblem


def shooting(
    hessian: Float[Array, "dof dof"],
    gradient: Float[Array, "dof"],
    l1: Float[Array, "*dof"] | float,
    lower: Float[Array, "dof"],
    upper: Float[Array, "dof"],
    start: Float[Array, "dof"],
    sweeps: int = 100,
    tolerance: ArrayLike = 1e-8,
    leaps: bool = True,
) -> Float[Array, "dof"]:
    """Solve a quadratic with an L1 term and limits by shooting, the solver of Eq. 10.

    From Fu, Journal of Computational and Graphical Statistics 7, 1998.

    Minimises `delta^T H delta - 2 g^T delta + sum_j l1_j |delta_j|` in [lower, upper] by exact cyclic coordinate steps

        rho_j = g_j - sum_{k != j} H_jk delta_k
        delta_j = clip(sign(rho_j) max(|rho_j| - l1_j / 2, 0) / H_jj, lower_j, upper_j)

    until no coordinate changes by more than `tolerance` or the rounding of rho_j, at most `sweeps` times. The threshold
    is l1 / 2 because the quadratic is not halved. A coordinate with H_jj = 0 keeps its start.

    With `leaps`, which the publication has not, the coordinates that lie neither at a limit nor at 0 are solved for
    together before each sweep, as far as the first of them stays there: a few sweeps then do where hundreds are needed
    for coordinates that depend on each other.
    """
    size = start.shape[0]
    l1 = jnp.broadcast_to(jnp.asarray(l1, start.dtype), (size,))
    diagonal = jnp.diagonal(hessian)
    inverse = jnp.where(diagonal > 0, 1 / jnp.where(diagonal > 0, diagonal, 1.0), 0.0)
    sizes = jnp.abs(hessian)

    def leap(delta: Float[Array, "dof"]) -> Float[Array, "dof"]:
        free = (diagonal > 0) & (delta > lower) & (delta < upper) & ((delta != 0) | (l1 == 0))
        face = jnp.where(free[:, None] & free, hessian, jnp.eye(size, dtype=delta.dtype))
        slope = gradient - jnp.matmul(hessian, delta, precision="highest") - 0.5 * l1 * jnp.sign(delta)
        way = jax.scipy.linalg.cho_solve((jnp.linalg.cholesky(face), True), jnp.where(free, slope, 0.0))
        above = jnp.where((delta < 0) & (l1 > 0), 0.0, upper)
        below = jnp.where((delta > 0) & (l1 > 0), 0.0, lower)
        wall = jnp.where(way > 0, above, below)
        room = jnp.where(way == 0, jnp.inf, (wall - delta) / jnp.where(way == 0, 1.0, way))
        share = jnp.minimum(1.0, room.min())
        there = jnp.where(room <= share, wall, jnp.clip(delta + share * way, below, above))
        return jnp.where(jnp.all(jnp.isfinite(way)), there, delta)

    def coordinate(
        j: Int[Array, ""], carry: tuple[Array, Array, Array], rounding: Float[Array, "dof"]
    ) -> tuple[Array, Array, Array]:
        delta, remainder, change = carry  # remainder = g - H delta
        rho = remainder[j] + diagonal[j] * delta[j]
        shrunk = jnp.sign(rho) * jnp.maximum(jnp.abs(rho) - 0.5 * l1[j], 0.0) * inverse[j]
        moved = jnp.where(diagonal[j] > 0, jnp.clip(shrunk, lower[j], upper[j]), delta[j])
        step = moved - delta[j]
        told = jnp.where(jnp.abs(step) > rounding[j], jnp.abs(step), 0.0)
        return delta.at[j].set(moved), remainder - step * hessian[j], jnp.maximum(change, told)

    def sweep(carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        count, delta, _ = carry
        delta = leap(delta) if leaps else delta
        remainder = gradient - jnp.matmul(hessian, delta, precision="highest")
        terms = jnp.abs(gradient) + jnp.matmul(sizes, jnp.abs(delta), precision="highest")
        step = partial(coordinate, rounding=4 * jnp.finfo(delta.dtype).eps * terms * inverse)
        delta, _, change = jax.lax.fori_loop(0, size, step, (delta, remainder, jnp.zeros((), delta.dtype)))
        return count + 1, delta, change

    def unfinished(carry: tuple[Array, Array, Array]) -> Array:
        count, _, change = carry
        return (count < sweeps) & (change > tolerance)

    first = (jnp.zeros((), jnp.int32), jnp.clip(start, lower, upper), jnp.full((), jnp.inf, start.dtype))
    return jax.lax.while_loop(unfinished, sweep, first)[1]


class _Iterate(eqx.Module):
    delta: Float[Array, "dof"]
    hessian: Float[Array, "dof dof"]  # J^T J at delta
    slope: Float[Array, "dof"]  # J^T r at delta
    objective: Float[Array, ""]


class _Carry(eqx.Module):
    at: _Iterate
    damping: Float[Array, ""]
    history: Float[Array, "round"]
    round: Int[Array, ""]
    finished: Bool[Array, ""]


class Shooting(AbstractRefiner):
    """Eq. 8 to 10 of the paper: Gauss-Newton rounds, each solved by `shooting` (Fu 1998) from the current increment.

    At delta_k, with r = r_k + J (delta - delta_k), a round minimises

        |r|^2 + sum_j l1_j |delta_j| + sum_j w_j (delta_j - prior_j)^2 + mu |delta - delta_k|^2   in [lower, upper].

    The step is taken if the true objective decreases (mu / 3), otherwise mu * 4. mu starts at `damping * trace(J^T J) /
    D`. The L1 acts on the whole increment from the previous frame, not on the Gauss-Newton step, so a subject at rest
    gives exact zeros. The paper says "gradient descent" and "shooting" for the same step; this is both.

    Attributes:
        max_rounds: Gauss-Newton rounds at most; 30.
        sweeps: coordinate sweeps at most in each; 100.
        leaps: between sweeps solve for all coordinates that are free together, see `shooting`; False is the paper.
        reweights: solves for the norm "l2"; 10.
        damping: mu at the start, share of the mean of J^T J's diagonal; 0.001.
        tolerance: a round that moves no coordinate further ends the loop (at least a few roundings of the float type).
    """

    max_rounds: int = eqx.field(static=True, default=30)
    sweeps: int = eqx.field(static=True, default=100)
    leaps: bool = eqx.field(static=True, default=True)
    reweights: int = eqx.field(static=True, default=10)
    damping: Knob = knob(1e-3)
    tolerance: Knob = knob(1e-11)

    def solve(self, problem: RefineProblem, start: Float[Array, "dof"]) -> Refined:
        size, rounding = start.shape[0], jnp.finfo(start.dtype).eps
        identity = jnp.eye(size, dtype=start.dtype)

        def evaluate(delta: Float[Array, "dof"]) -> _Iterate:
            residual, jacobian = problem.linearise(delta)
            hessian = jnp.matmul(jacobian.T, jacobian, precision="highest")
            slope = jnp.matmul(residual, jacobian, precision="highest")
            return _Iterate(delta, hessian, slope, problem.objective_from(residual, delta))

        def gauss_newton(carry: _Carry) -> _Carry:
            at, mu = carry.at, carry.damping
            hessian = at.hessian + (problem.prior_weight + mu) * identity
            gradient = jnp.matmul(at.hessian, at.delta, precision="highest") - at.slope
            gradient = gradient + problem.prior_weight * problem.prior + mu * at.delta
            limit = jnp.maximum(self.tolerance, 4 * rounding * jnp.max(jnp.abs(at.delta)))
            box = (problem.lower, problem.upper)
            moved = shooting(hessian, gradient, problem.l1, *box, at.delta, self.sweeps, 0.1 * limit, self.leaps)
            trial = evaluate(moved)
            accepted = trial.objective <= at.objective + 4 * rounding * jnp.abs(at.objective)
            after = jax.tree.map(lambda new, old: jnp.where(accepted, new, old), trial, at)
            step = jnp.max(jnp.abs(moved - at.delta))
            return _Carry(
                after,
                jnp.where(accepted, mu / 3, mu * 4),
                carry.history.at[carry.round + 1].set(after.objective),
                carry.round + 1,
                step <= limit,
            )

        first = evaluate(start)
        mu = (self.damping * jnp.trace(first.hessian) / size).astype(start.dtype)
        history = jnp.full(self.max_rounds + 1, first.objective)
        carry = _Carry(first, mu, history, jnp.zeros((), jnp.int32), jnp.zeros((), bool))
        last = jax.lax.while_loop(lambda c: (c.round < self.max_rounds) & ~c.finished, gauss_newton, carry)
        history = jnp.where(jnp.arange(self.max_rounds + 1) > last.round, last.at.objective, last.history)
        violation = problem.stationarity(last.at.delta)
        converged = last.finished & jnp.isfinite(last.at.objective)
        return Refined(last.at.delta, last.at.objective, history, violation, last.round, converged)
