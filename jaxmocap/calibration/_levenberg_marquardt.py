"""Least squares with sparse factors: Levenberg and Marquardt's method, robust by reweighting."""

from collections.abc import Callable
from typing import NamedTuple, Protocol

import numpy as np
from jaxtyping import Float
from scipy.sparse import csc_array, csr_array, diags_array
from scipy.sparse.linalg import SuperLU, splu

_MOST_STEPS = 200
_ENOUGH = 1e-9  # decrease of the cost, relative


class Problem(Protocol):
    """Residuals in standard deviations, and their sparse Jacobian."""

    def residuals(self, values: Float[np.ndarray, "unknown"], /) -> Float[np.ndarray, "row"]: ...

    def jacobian(self, values: Float[np.ndarray, "unknown"], /) -> csr_array: ...


class Loss(NamedTuple):
    """A robust loss over all rows, and the weight of each row's square that has its slope."""

    cost: Callable[[Float[np.ndarray, "row"]], float]
    weight: Callable[[Float[np.ndarray, "row"]], Float[np.ndarray, "row"]]


SOFT_L1 = Loss(
    lambda rows: float(np.sum(2 * (np.sqrt(1 + rows**2) - 1))),
    lambda rows: 1 / np.sqrt(1 + rows**2),
)


def factors(normal: csc_array) -> SuperLU:
    """Factor normal equations whose unknowns are in a good order: those of many, such as joints by frame, first."""
    return splu(normal, permc_spec="NATURAL", diag_pivot_thresh=0.0, options={"SymmetricMode": True})


class Minimum(NamedTuple):
    """The unknowns, the cost, and J^T J of the last step, weighted."""

    values: Float[np.ndarray, "unknown"]
    cost: float
    normal: csc_array


def minimise(
    problem: Problem,
    values: Float[np.ndarray, "unknown"],
    loss: Loss = SOFT_L1,
    steps: int = _MOST_STEPS,
    enough: float = _ENOUGH,
) -> Minimum:
    """Minimise the sum of robust residuals, until a step gains less than the share `enough`.

    Sparse factors make a step of a thousand joints a matter of milliseconds; SciPy's least squares takes dense factors
    or an iterative solver, which where cameras stand close together needs minutes.
    """
    damping, rows = 1e-3, problem.residuals(values)
    cost = loss.cost(rows)
    normal = csc_array((values.size, values.size))
    for _ in range(steps):
        weight, jacobian = loss.weight(rows), problem.jacobian(values)
        weighted = jacobian.T * weight
        normal = csc_array(weighted @ jacobian)
        diagonal = normal.diagonal()
        normal += diags_array(np.full(values.size, 1e-12 * diagonal.max()))
        step = -factors(csc_array(normal + diags_array(damping * diagonal))).solve(weighted @ rows)
        moved = problem.residuals(values + step)
        after = loss.cost(moved)
        if not after < cost:
            damping *= 4
            if damping > 1e8:
                break
            continue
        settled = cost - after < enough * cost
        values, rows, cost, damping = values + step, moved, after, damping / 3
        if settled:
            break
    return Minimum(values, cost, normal)
