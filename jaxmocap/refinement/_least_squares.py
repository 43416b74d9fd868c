"""Damped Gauss-Newton steps on rows of surface points and rays, with the priors of Eq. 10, for any refiner."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxmocap._cache import cached_jit, small_jit
from jaxmocap.character import ROOT_DOFS, Character, Pose, retract
from jaxmocap.energies import LineResidual, SurfaceLines, join_lines
from jaxmocap.refiners import AbstractRefiner, RefineProblem

DAMPING = 1e-3
"""Of the first step, as a share of the diagonal of J^T J (Levenberg and Marquardt)."""

SETTLED = 1e-4
"""Metres and radians: a step that moves less is the last one."""

LandmarkRows = Callable[[Character, Pose], Float[Array, "rows"]]
"""Residuals of a pose's landmarks, such as `LandmarkRays`."""


class Rows(NamedTuple):
    """Lines with one scale (metres that count as 1) and one Geman-McClure scale (metres; infinity: plain squares)."""

    lines: SurfaceLines
    scale: float | Array
    robust: float | Array


class Prior(NamedTuple):
    """The box and the terms of Eq. 10 on the increment from the base pose."""

    lower: Float[Array, "dof"]
    upper: Float[Array, "dof"]
    l1: Float[Array, "dof"]
    weight: Float[Array, "dof"]
    target: Float[Array, "dof"]


@jax.jit
def free_prior(character: Character, base: Pose, weight: float | Array | np.ndarray = 1e-3) -> Prior:
    """Make a prior of joint limits and a weak pull to the base pose, without L1."""
    skeleton = character.skeleton
    far, still = jnp.full(ROOT_DOFS, 10.0), jnp.zeros(skeleton.num_dofs)
    return Prior(
        jnp.concatenate([-far, skeleton.lower - base.angles]),
        jnp.concatenate([far, skeleton.upper - base.angles]),
        still,
        jnp.broadcast_to(jnp.asarray(weight, jnp.float32), still.shape),
        still,
    )


def _residual(
    character: Character, base: Pose, rows: tuple[Rows, ...], landmarks: tuple[LandmarkRows, ...]
) -> Callable[[Float[Array, "dof"]], Float[Array, "row"]]:
    parts = []
    if rows:  # as one part: it compiles and runs faster than many
        lines = join_lines(*(row.lines for row in rows))
        counts = [row.lines.weight.shape[0] for row in rows]
        scale, robust = (
            jnp.concatenate([jnp.full(n, v, jnp.float32) for n, v in zip(counts, values, strict=True)])
            for values in ([row.scale for row in rows], [row.robust for row in rows])
        )
        parts.append(LineResidual(character, base, lines, scale, robust))

    def residual(delta: Array) -> Array:
        values = [part(delta) for part in parts]
        values += [rays(character, retract(character.skeleton, base, delta)) for rays in landmarks]
        return jnp.concatenate(values)

    return residual


class Normal(NamedTuple):
    """Normal equations of all rows at an increment: sum of squares, J^T r, J^T J."""

    square: Float[Array, ""]
    slope: Float[Array, "dof"]
    hessian: Float[Array, "dof dof"]


@cached_jit
def normal_equations(
    character: Character,
    base: Pose,
    delta: Float[Array, "dof"],
    rows: tuple[Rows, ...],
    landmarks: tuple[LandmarkRows, ...],
) -> Normal:
    """Linearise all rows at `delta`, an increment of `base`."""
    residual = _residual(character, base, rows, landmarks)
    jacobian, value = jax.jacfwd(lambda d: (residual(d),) * 2, has_aux=True)(delta)
    slope = jnp.matmul(value, jacobian, precision="highest")
    return Normal(jnp.sum(value**2), slope, jnp.matmul(jacobian.T, jacobian, precision="highest"))


@small_jit
def damped_step(
    normal: Normal, delta: Float[Array, "dof"], prior: Prior, damping: Float[Array, ""], refiner: AbstractRefiner
) -> Float[Array, "dof"]:
    """Solve the normal equations with the L1, the prior and the box.

    They are compressed to a row per DoF, so any refiner is cheap. Rows leave no trace in the shapes: sets of any length
    share the program, which takes longer to compile than theirs.
    """
    diagonal = jnp.diagonal(normal.hessian)
    damped = normal.hessian + jnp.diag(damping * diagonal + 1e-6 * diagonal.max() + 1e-9)
    factor = jnp.linalg.cholesky(damped).T
    target = delta - jax.scipy.linalg.cho_solve((factor, False), normal.slope)
    problem = RefineProblem(
        residual=lambda d: jnp.matmul(factor, d - target, precision="highest"),
        jacobian=lambda d: factor,
        prior=prior.target,
        lower=prior.lower,
        upper=prior.upper,
        l1=prior.l1,
        prior_weight=prior.weight,
    )
    return refiner.refine(problem, delta).value


@cached_jit
def sum_of_squares(
    character: Character,
    base: Pose,
    delta: Float[Array, "dof"],
    rows: tuple[Rows, ...],
    landmarks: tuple[LandmarkRows, ...],
) -> Float[Array, ""]:
    """Sum the squares of all rows at `delta`."""
    return jnp.sum(_residual(character, base, rows, landmarks)(delta) ** 2)


def _penalty(prior: Prior, delta: Float[Array, "dof"]) -> float:
    l1, weight, target, at = (np.asarray(leaf, np.float64) for leaf in (prior.l1, prior.weight, prior.target, delta))
    return float(np.sum(l1 * np.abs(at)) + np.sum(weight * (at - target) ** 2))


def descend(
    character: Character,
    base: Pose,
    delta: Float[Array, "dof"],
    rows: tuple[Rows, ...],
    landmarks: tuple[LandmarkRows, ...],
    prior: Prior,
    refiner: AbstractRefiner,
    steps: int = 3,
) -> tuple[Float[Array, "dof"], Float[Array, "dof dof"]]:
    """Take a few accepted Gauss-Newton steps with fixed correspondences; return the increment and the last J^T J.

    Each linearises all rows at `delta` (an increment of `base`), solves with the L1, the prior and the box, and counts
    if the true objective does not grow.
    """
    damping, hessian = DAMPING, None
    scales = [np.array((row.scale, row.robust), np.float32) for row in rows]  # arrays, so that they are not compiled in
    rows = tuple(Rows(row.lines, *jax.device_put(tuple(pair))) for row, pair in zip(rows, scales, strict=True))
    for _ in range(steps):
        normal = normal_equations(character, base, delta, rows, landmarks)
        moved, hessian = damped_step(normal, delta, prior, jnp.asarray(damping, jnp.float32), refiner), normal.hessian
        before = float(normal.square) + _penalty(prior, delta)
        after = float(sum_of_squares(character, base, moved, rows, landmarks)) + _penalty(prior, moved)
        if after <= before * (1 + 1e-6):
            farthest = float(np.abs(np.asarray(moved) - np.asarray(delta)).max())
            delta, damping = moved, damping / 3
            if farthest < SETTLED:
                break
        else:
            damping = max(damping, 1e-4) * 8
    assert hessian is not None
    return delta, hessian
