"""Gauss-Newton with shooting inside: the reference refiner."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxmocap._types import Knob, knob

from ._base import AbstractRefiner, Refined
from ._coordinate_descent import shooting
from ._problem import RefineProblem


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

    - `max_rounds`, `sweeps`: bounds on the rounds and on the coordinate sweeps in each.
    - `leaps`: between sweeps solve for all coordinates that are free together, see `shooting`; False is the paper.
    - `tolerance`: a round that moves no coordinate further ends the loop (at least a few roundings of the float type).
    - `reweights`: solves for the norm `"l2"`.
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
