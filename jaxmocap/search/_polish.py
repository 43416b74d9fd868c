"""Polish: the energy of the search itself, made smooth, followed downhill from where the search ended.

Not in the paper, whose refinement minimises another energy than its search ("the objective of global optimization and
local optimization is not consistent") and names this as future work.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix
from jaxtyping import Array, Float, Int

from jaxmocap.character import Character, Pose, Skeleton, clamp, retract
from jaxmocap.energies import SearchEnergy, SoftScore, soft_score
from jaxmocap.observation import FrameProblem
from jaxmocap.render import SoftSettings

_TRANSLATION, _ROTATION, _ANGLE = 0.02, 0.05, 0.1
"""Metres and radians that count as one step: the valleys of the energy are about as wide."""


@dataclass(frozen=True)
class PolishPlan:
    """Say how the search's answer follows Eq. 5 with soft visibility downhill, by a quasi-Newton method (BFGS).

    Attributes:
        steps: at most; 15.
        tolerance: relative and absolute change of energy and pose at which it stops; 1e-4.
        soft: the soft rasteriser's width; its room is enlarged where it does not do.
    """

    steps: int = 15
    tolerance: float = 1e-4
    soft: SoftSettings = field(default_factory=SoftSettings)


def fitted(settings: SoftSettings, needed: Int[np.ndarray, "3"]) -> SoftSettings:
    """Fit the settings' bounds to `needed` windows, pixels and shares: powers of two, so that they seldom change."""
    windows, pixels, shares = (2 ** int(np.ceil(np.log2(max(1.2 * count, 256)))) for count in np.asarray(needed))
    return replace(settings, windows=windows, pixels=pixels, shares=shares)


def _overflows(settings: SoftSettings, needed: Int[Array, "3"]) -> bool:
    return bool((np.asarray(needed) > (settings.windows, settings.pixels, settings.shares)).any())


@eqx.filter_jit
def _measure(
    energy: SearchEnergy, character: Character, pose: Pose, problem: FrameProblem, settings: SoftSettings
) -> SoftScore:
    return soft_score(energy, character, pose, problem, settings)


@eqx.filter_jit
def _descend(
    energy: SearchEnergy,
    character: Character,
    pose: Pose,
    problem: FrameProblem,
    settings: SoftSettings,
    steps: int,
    tolerance: float,
) -> tuple[Pose, tuple[Float[Array, ""], Int[Array, "3"]]]:
    def value(moved: Pose) -> tuple[Float[Array, ""], Array]:
        score = soft_score(energy, character, moved, problem, settings)
        return score.total, score.needed

    return downhill(value, character.skeleton, pose, steps, tolerance)


def downhill(
    value: Callable[[Pose], tuple[Float[Array, ""], Any]], skeleton: Skeleton, pose: Pose, steps: int, tolerance: float
) -> tuple[Pose, tuple[Float[Array, ""], Any]]:
    """Take at most `steps` of BFGS downhill within the joint limits; return the pose and what `value` is there.

    `value` is a differentiable energy and anything beside it. Pure: for `jit`.
    """
    unit = jnp.asarray(skeleton.per_dof(root=_ROTATION, angles=_ANGLE)).at[:3].set(_TRANSLATION)

    def moved(step: Float[Array, "dof"]) -> Pose:
        return clamp(skeleton, retract(skeleton, pose, unit * step))

    solver = optimistix.BFGS(rtol=tolerance, atol=tolerance)
    start = jnp.zeros(skeleton.num_dofs)
    with jax.default_matmul_precision("highest"):  # BFGS leaves it to JAX
        found = optimistix.minimise(
            lambda step, _: value(moved(step)), solver, start, has_aux=True, max_steps=steps, throw=False
        )
    best = jnp.where(jnp.isfinite(found.value).all(), found.value, 0.0)
    return moved(best), value(moved(best))


def polish(
    energy: SearchEnergy, character: Character, pose: Pose, problem: FrameProblem, plan: PolishPlan | None = None
) -> tuple[Pose, float, float]:
    """Go downhill on the soft Eq. 5 within the joint limits; return the pose and the soft energy before and after.

    Called from the host: bounds of `plan.soft` that are too small are enlarged. The pose stays as it was when no step
    lowers the energy.
    """
    plan = PolishPlan() if plan is None else plan
    settings = plan.soft
    before = _measure(energy, character, pose, problem, settings)
    while _overflows(settings, before.needed):
        settings = fitted(settings, np.asarray(before.needed))
        before = _measure(energy, character, pose, problem, settings)
    needed = np.asarray(before.needed)
    while True:
        settings = fitted(settings, needed)
        better, (after, used) = _descend(energy, character, pose, problem, settings, plan.steps, plan.tolerance)
        if not _overflows(settings, used):
            break
        needed = np.maximum(needed, np.asarray(used))
    if float(after) < float(before.total):
        return better, float(before.total), float(after)
    return pose, float(before.total), float(before.total)
