"""The refinement problem: least squares, an L1 term towards zero, a prior and a box; and what every refiner is."""

import abc
from collections.abc import Callable
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxmocap._results import InputError
from jaxmocap._types import Knob, knob
from jaxmocap.geometry import huber, huber_weight

Norm = Literal["squared", "l2"]


class RefineProblem(eqx.Module):
    """Eq. 8 to 10 of the paper in the increment delta = chi - chi_{t-1}, radians and metres.

    With the norm `"squared"` (default; the solver is defined for least squares, although the paper prints no squares)

        minimise  sum_i |e_i|^2 + sum_j l1_j |delta_j| + sum_j prior_weight_j (delta_j - prior_j)^2   in [lower, upper]

    and with `"l2"`, as printed, `sum_i |e_i| + sum_j l1_j |delta_j| + |prior_weight * (delta - prior)|`, each norm
    rounded off (Huber) below its floor and less half that floor.

    - `residual`: delta (D,) -> (R,); rows `group_size * i ...` form the vector e_i.
    - `jacobian`: delta (D,) -> (R, D); forward differentiation of `residual` if not given.
    - `l1`, `prior_weight`: one value per degree of freedom, or one for all. They enter as they are, so scale the
      residual (`e / sigma_e`) until lambda = 3 gives the dead zone you want: `l1_j / (2 H_jj)`, with H = sum J^T J.
    - `prior`: the predicted increment, here the autoregression's.
    - `residual_floor`, `prior_floor`: of the norm `"l2"` only; 5 mm for residuals in metres, and 1e-3.
    """

    residual: Callable[[Float[Array, "dof"]], Float[Array, "row"]]
    prior: Float[Array, "dof"]
    lower: Float[Array, "dof"]
    upper: Float[Array, "dof"]
    l1: Float[Array, "*dof"] = knob(3.0)
    prior_weight: Float[Array, "*dof"] = knob(3.0)
    jacobian: Callable[[Float[Array, "dof"]], Float[Array, "row dof"]] | None = None
    residual_floor: Knob = knob(0.005)
    prior_floor: Knob = knob(1e-3)
    norm: Norm = eqx.field(static=True, default="squared")
    group_size: int = eqx.field(static=True, default=1)

    def __check_init__(self) -> None:
        if self.norm not in ("squared", "l2"):
            raise InputError(f"norm is {self.norm!r}, expected 'squared' or 'l2'.")

    def linearise(self, delta: Float[Array, "dof"]) -> tuple[Float[Array, "row"], Float[Array, "row dof"]]:
        """Compute residual and Jacobian at `delta`."""
        derivative = jax.jacfwd(self.residual) if self.jacobian is None else self.jacobian
        return self.residual(delta), derivative(delta)

    def objective(self, delta: Float[Array, "dof"]) -> Float[Array, ""]:
        """Compute the value being minimised."""
        return self.objective_from(self.residual(delta), delta)

    def objective_from(self, residual: Float[Array, "row"], delta: Float[Array, "dof"]) -> Float[Array, ""]:
        """Compute `objective` where the residual is known already."""
        still = jnp.sum(self.l1 * jnp.abs(delta))
        if self.norm == "squared":
            return jnp.sum(residual**2) + still + jnp.sum(self.prior_weight * (delta - self.prior) ** 2)
        floor, prior_floor = self.residual_floor, self._scaled_prior_floor()
        data = jnp.sum(huber(self._group_norms(residual), floor)) / (2 * floor)
        return data + still + huber(self._prior_norm(delta), prior_floor) / (2 * prior_floor)

    def reweighted(self, delta: Float[Array, "dof"]) -> "RefineProblem":
        """Build the squared problem that touches the `"l2"` one at `delta` from above.

        Its rows weigh `1 / (2 max(|e_i|, floor))`.

        The 2 makes the derivative of `w |e|^2` that of `|e|`; without it data and prior would count double against the
        L1.
        """
        floor, prior_floor = self.residual_floor, self._scaled_prior_floor()
        weight = huber_weight(self._group_norms(self.residual(delta)), floor) / (2 * floor)
        root = jnp.repeat(jnp.sqrt(weight), self.group_size)
        share = huber_weight(self._prior_norm(delta), prior_floor) / (2 * prior_floor)
        jacobian = self.jacobian
        return RefineProblem(
            residual=lambda at: root * self.residual(at),
            prior=self.prior,
            lower=self.lower,
            upper=self.upper,
            l1=self.l1,
            prior_weight=self.prior_weight**2 * share,
            jacobian=None if jacobian is None else lambda at: root[:, None] * jacobian(at),
        )

    def smooth_slope(self, delta: Float[Array, "dof"]) -> Float[Array, "dof"]:
        """Differentiate the objective without its L1 term."""
        squared = self if self.norm == "squared" else self.reweighted(delta)
        residual, jacobian = squared.linearise(delta)
        slope = 2 * jnp.matmul(residual, jacobian, precision="highest")
        return slope + 2 * squared.prior_weight * (delta - self.prior)

    def stationarity(self, delta: Float[Array, "dof"]) -> Float[Array, ""]:
        """Measure the largest violation of the Karush-Kuhn-Tucker conditions: no feasible direction may go down.

        With s the derivative of the smooth part, both one-sided derivatives s_j + l1_j (up) and -s_j + l1_j (down) must
        be non-negative, except those that leave the box.
        """
        slope = self.smooth_slope(delta)
        up = slope + self.l1 * jnp.where(delta >= 0, 1.0, -1.0)
        down = -slope + self.l1 * jnp.where(delta <= 0, 1.0, -1.0)
        return jnp.max(jnp.maximum(jnp.where(delta < self.upper, -up, 0.0), jnp.where(delta > self.lower, -down, 0.0)))

    def _group_norms(self, residual: Float[Array, "row"]) -> Float[Array, "group"]:
        return _safe_norm(residual.reshape(-1, self.group_size))

    def _prior_norm(self, delta: Float[Array, "dof"]) -> Float[Array, ""]:
        return _safe_norm(self.prior_weight * (delta - self.prior))

    def _scaled_prior_floor(self) -> Float[Array, ""]:
        largest = jnp.max(self.prior_weight)
        return self.prior_floor * jnp.where(largest > 0, largest, 1.0)


class Refined(eqx.Module):
    """Arrays only, so that it passes through `vmap`. Nothing is raised: look at `converged`."""

    value: Float[Array, "dof"]
    objective: Float[Array, ""]
    history: Float[Array, "round"]  # objective after each round
    stationarity: Float[Array, ""]  # largest violation of the optimality conditions, see `RefineProblem.stationarity`
    steps: Int[Array, ""]
    converged: Bool[Array, ""]


class AbstractRefiner(eqx.Module):
    """Minimises a `RefineProblem` from a start. The norm `"l2"` is handled here, by reweighting, for every refiner."""

    reweights: eqx.AbstractVar[int]

    @abc.abstractmethod
    def solve(self, problem: RefineProblem, start: Float[Array, "dof"]) -> Refined:
        """Minimise a problem of norm `"squared"` from a start inside the box."""

    def refine(self, problem: RefineProblem, start: Float[Array, "dof"]) -> Refined:
        """Minimise `problem` from `start`: the warm start, for example the search's result minus chi_{t-1}.

        The precision is the widest of the start, the prior and the box.
        """
        dtype = jnp.result_type(start, problem.prior, problem.lower, problem.upper)
        start = jnp.clip(start, problem.lower, problem.upper).astype(dtype)
        if problem.norm == "squared":
            return self.solve(problem, start)

        def reweight(delta: Float[Array, "dof"], _: None) -> tuple[Array, tuple[Array, Array, Array]]:
            solved = self.solve(problem.reweighted(delta), delta)
            return solved.value, (problem.objective(solved.value), solved.steps, solved.converged)

        value, (history, steps, converged) = jax.lax.scan(reweight, start, length=self.reweights)
        objective, violation = history[-1], problem.stationarity(value)
        return Refined(value, objective, history, violation, jnp.sum(steps), converged[-1])


def _safe_norm(vectors: Float[Array, "*group size"]) -> Float[Array, "*group"]:
    """Length of each vector; its derivative at zero is zero."""
    squared = jnp.sum(vectors**2, axis=-1)
    return jnp.where(squared > 0, jnp.sqrt(jnp.where(squared > 0, squared, 1.0)), 0.0)
