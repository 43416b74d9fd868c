"""What every refiner is: a value that improves a start, and a record of how it went."""

import abc

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ._problem import RefineProblem


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
        """Minimise `problem` from `start`: the warm start, for example the search's result minus chi_{t-1}."""
        start = jnp.clip(start, problem.lower, problem.upper)
        if problem.norm == "squared":
            return self.solve(problem, start)

        def reweight(delta: Float[Array, "dof"], _: None) -> tuple[Array, tuple[Array, Array, Array]]:
            solved = self.solve(problem.reweighted(delta), delta)
            return solved.value, (problem.objective(solved.value), solved.steps, solved.converged)

        value, (history, steps, converged) = jax.lax.scan(reweight, start, length=self.reweights)
        objective, violation = history[-1], problem.stationarity(value)
        return Refined(value, objective, history, violation, jnp.sum(steps), converged[-1])
