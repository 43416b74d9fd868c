"""How an answer moves with a setting, without finding it anew: the implicit function theorem at a minimum."""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax
import optimistix
from jaxtyping import Array, Float

Objective = Callable[[Float[Array, "unknown"], Float[Array, "*setting"]], Float[Array, ""]]


class Sensitivity(NamedTuple):
    """`slope (unknown, *setting)`: the derivative of the minimum. `gradient (unknown)` should be zero at a minimum and
    `curvature (unknown)`, the eigenvalues of the Hessian, positive."""

    slope: Float[Array, "unknown *setting"]
    gradient: Float[Array, "unknown"]
    curvature: Float[Array, "unknown"]


@eqx.filter_jit
def sensitivity(
    objective: Objective, minimum: Float[Array, "unknown"], setting: Float[Array, "*setting"]
) -> Sensitivity:
    """Compute `d x* / d setting = -H^-1 d^2 E / (dx d setting)` for `x* = argmin_x E(x, setting)`.

    Valid where the gradient vanishes and the Hessian H is positive: look at `gradient` and `curvature`. Directions of
    no curvature (smaller than 1e-6 of the largest) are left out, since the minimum does not say where it is along them.
    """
    gradient = jax.grad(objective)
    solver, adjoint = optimistix.BFGS(1e-3, 1e-3), optimistix.ImplicitAdjoint(lineax.SVD(rcond=1e-6))

    def followed(setting: Float[Array, "*setting"]) -> Float[Array, "unknown"]:
        stay = {"max_steps": 1, "throw": False}  # the first step evaluates the start
        with jax.default_matmul_precision("highest"):  # BFGS leaves it to JAX
            return optimistix.minimise(objective, solver, minimum, setting, adjoint=adjoint, **stay).value

    hessian = jax.jacfwd(gradient)(minimum, setting)
    curvature = jnp.linalg.eigvalsh(0.5 * (hessian + hessian.T))
    return Sensitivity(jax.jacfwd(followed)(setting), gradient(minimum, setting), curvature)


def newton(
    objective: Objective, start: Float[Array, "unknown"], setting: Float[Array, "*setting"], steps: int = 20
) -> Float[Array, "unknown"]:
    """Find the minimum near `start` by damped Newton steps, each halved until the objective falls."""
    value = eqx.filter_jit(objective)
    slope = eqx.filter_jit(jax.grad(objective))
    curve = eqx.filter_jit(jax.jacfwd(jax.grad(objective)))
    here, best = start, float(value(start, setting))
    for _ in range(steps):
        values, vectors = jnp.linalg.eigh(curve(here, setting))
        floor = 1e-4 * jnp.abs(values).max()
        along = jnp.matmul(vectors.T, slope(here, setting), precision="highest")
        step = -jnp.matmul(vectors, along / jnp.maximum(jnp.abs(values), floor), precision="highest")
        for _ in range(12):
            there = float(value(here + step, setting))
            if there < best:
                break
            step = 0.5 * step
        else:
            return here
        gained, here, best = best - there, here + step, there
        if gained < 1e-9 * max(abs(best), 1e-9):
            return here
    return here
