"""The refinement problem through a general least squares library: the tracker's refiner."""

from collections.abc import Callable
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import optimistix as optx
from jaxtyping import Array, Float

from jaxmocap._results import InputError
from jaxmocap._types import Knob, knob

from ._problem import AbstractRefiner, Refined, RefineProblem

Method = Literal["levenberg_marquardt", "dogleg"]
METHODS = {"levenberg_marquardt": optx.LevenbergMarquardt, "dogleg": optx.Dogleg}


class LeastSquares(AbstractRefiner):
    """Eq. 8 to 10 of the paper by optimistix, with the L1 smoothed: `|x|` becomes `sqrt(x^2 + eps^2)`.

    The smoothed term enters as the residual `sqrt(l1) (x^2 + eps^2)^(1/4)`, and eps falls through `smoothing`, each
    solve starting at the last result. Afterwards increments below ten times the last eps become 0 where 0 is optimal.
    The box is a quadratic penalty, `bound_weight` times the stiffest degree of freedom, then a clip. Agrees to 2e-4
    radians in double precision, and 2e-3 in single, with `Shooting`, which is exact and the reference. In a tracker the
    two end as near to the truth and take as long (docs/choosing.md); this one compiles sooner and is the default.

    Attributes:
        method: "levenberg_marquardt" or "dogleg".
        max_steps: per value of eps; 1024. The last one needs 100 to 600.
        reweights: solves for the norm "l2"; 10.
        smoothing: values of eps, radians and metres, one solve after the other.
        bound_weight: of the penalty of the box, in units of the stiffest degree of freedom; 1000.
    """

    method: Method = eqx.field(static=True, default="levenberg_marquardt")
    max_steps: int = eqx.field(static=True, default=1024)
    reweights: int = eqx.field(static=True, default=10)
    smoothing: Float[Array, "round"] = eqx.field(
        converter=lambda values: jnp.asarray(values, jnp.float32), default=(1e-2, 1e-3, 1e-4)
    )
    bound_weight: Knob = knob(1e3)

    def __check_init__(self) -> None:
        if self.method not in METHODS:
            raise InputError(f"method is {self.method!r}, expected one of {', '.join(METHODS)}.")

    def solve(self, problem: RefineProblem, start: Float[Array, "dof"]) -> Refined:
        # Normal equations: the system is small and damped, and this is twenty times faster than the default QR.
        solver = METHODS[self.method](rtol=1e-6, atol=1e-6, linear_solver=lx.Normal(lx.Cholesky()))
        residual = _residual_with_jacobian(problem)
        _, jacobian = problem.linearise(start)
        stiffest = jnp.max(jnp.sum(jacobian**2, axis=0) + problem.prior_weight)
        wall = jnp.sqrt(self.bound_weight * stiffest).astype(start.dtype)

        def rows(delta: Float[Array, "dof"], eps: Float[Array, ""]) -> tuple[Array, ...]:
            outside = jnp.maximum(delta - problem.upper, 0.0) + jnp.minimum(delta - problem.lower, 0.0)
            return (
                residual(delta),
                jnp.sqrt(problem.prior_weight) * (delta - problem.prior),
                jnp.sqrt(problem.l1) * (delta**2 + eps**2) ** 0.25,
                wall * outside,
            )

        def continue_from(delta: Float[Array, "dof"], eps: Float[Array, ""]) -> tuple[Array, tuple[Array, ...]]:
            first = jnp.where(jnp.abs(delta) < 1e-6, 1e-6, delta)  # the smoothed L1 has no slope exactly at zero
            solution = optx.least_squares(
                rows, solver, first, args=eps.astype(start.dtype), max_steps=self.max_steps, throw=False
            )
            value = solution.value.astype(start.dtype)
            done = solution.result == optx.RESULTS.successful
            return value, (problem.objective(value), solution.stats["num_steps"], done)

        found, (history, steps, done) = jax.lax.scan(continue_from, start, self.smoothing)
        value = self._settle(problem, start, found)
        return Refined(value, problem.objective(value), history, problem.stationarity(value), jnp.sum(steps), done[-1])

    def _settle(
        self, problem: RefineProblem, start: Float[Array, "dof"], found: Float[Array, "dof"]
    ) -> Float[Array, "dof"]:
        """Into the box, small increments to zero where zero is optimal, and never worse than the start."""
        small = (jnp.abs(found) < 10 * self.smoothing[-1]) & (problem.l1 > 0)
        zeroed = jnp.clip(jnp.where(small, 0.0, found), problem.lower, problem.upper)
        still = small & (jnp.abs(problem.smooth_slope(zeroed)) <= problem.l1)
        value = jnp.clip(jnp.where(still, 0.0, found), problem.lower, problem.upper)
        return jnp.where(problem.objective(value) <= problem.objective(start), value, start)


def _residual_with_jacobian(problem: RefineProblem) -> Callable[[Float[Array, "dof"]], Float[Array, "row"]]:
    """Return the residual, differentiated by the problem's own Jacobian where it has one."""
    jacobian = problem.jacobian
    if jacobian is None:
        return problem.residual
    residual = jax.custom_jvp(problem.residual)
    residual.defjvp(lambda at, moved: (problem.residual(*at), jnp.matmul(jacobian(*at), *moved, precision="highest")))
    return residual
