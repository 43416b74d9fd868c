"""How far each joint may be from the truth: a covariance from the refinement's J^T J and the last particles."""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxmocap._cache import cached_jit
from jaxmocap.character import ROOT_DOFS, Pose, Skeleton, landmark_positions, retract

from ._frame_verdict import FrameResult


class UncertaintySettings(NamedTuple):
    """How J^T J and the last particles become a covariance; not in the paper.

    `scale`, `doubt` and `floor` are, with `motion.TAILS`, those of greatest likelihood on random synthetic films
    (`benchmarks/verdict_fit.py`). Errors have heavier tails than any normal distribution, for a limb is right or
    mistaken: they follow Student's t, whose scale matrix this is. `benchmarks/uncertainty.py` measures on any capture
    how often the regions hold.

    Attributes:
        correlated: rows of the refinement that tell as much as one, for neighbouring points of a contour err alike.
        free_root: deviation of a root that nothing tells, metres and radians.
        free_angle: deviation of an angle that nothing tells, radians.
        particles: weight of the last particles' deviation.
        scale: factor on all deviations.
        doubt: a landmark without confidence has 1 + `doubt` times the deviation.
        floor: metres of deviation that every joint has, of the skeleton itself.
    """

    correlated: float = 30.0
    free_root: float = 0.3
    free_angle: float = 0.8
    particles: float = 1.0
    scale: float = 0.09
    doubt: float = 7.0
    floor: float = 0.006


def joint_covariances(
    skeleton: Skeleton,
    results: Sequence[FrameResult],
    settings: UncertaintySettings | None = None,
    confidence: Float[np.ndarray, "frame landmark"] | None = None,
    misfit: float = 0.0,
) -> Float[np.ndarray, "frame landmark 3 3"]:
    """Compute every landmark's covariance in every frame, square metres, world axes: first order around the pose.

    `confidence` is what is left of it once the sequence is judged, by default what each frame alone tells. `misfit` is
    the character's, metres.

    What the pictures do not tell, an arm behind the body, keeps the deviation it has when free. A frame at which the
    tracking began takes the J^T J of a frame next to it; one that was passed over has none.
    """
    settings = UncertaintySettings() if settings is None else settings
    hessians = _hessians(results)
    deviations = np.stack([np.asarray(result.deviation, np.float32) for result in results])
    poses = Pose(
        jax.device_put(np.stack([r.pose.root for r in results])),
        jax.device_put(np.stack([r.pose.angles for r in results])),
    )
    numbers = jax.tree.map(jnp.float32, settings)  # arrays: other settings share the program
    found = np.asarray(_covariances(skeleton, poses, jax.device_put(hessians), jax.device_put(deviations), numbers))
    trusted = [result.confidence for result in results] if confidence is None else confidence
    doubt = 1 - np.stack([np.asarray(row, np.float32) for row in trusted])
    factor = settings.scale * (1 + settings.doubt * doubt)
    everywhere = settings.floor**2 + misfit**2
    return factor[..., None, None] ** 2 * found + everywhere * np.eye(3, dtype=np.float32)


def mean_deviations(skeleton: Skeleton, results: Sequence[FrameResult]) -> Float[np.ndarray, "frame"] | None:
    """Average the standard deviation of a joint's place over the landmarks, metres, whatever the confidence.

    None where nothing was refined, which would have told it.
    """
    if all(result.hessian is None for result in results):
        return None
    settings = UncertaintySettings(doubt=0.0)
    variances = np.trace(joint_covariances(skeleton, results, settings), axis1=-2, axis2=-1)
    return np.sqrt(variances).mean(axis=1, dtype=float)


def _hessians(results: Sequence[FrameResult]) -> Float[np.ndarray, "frame dof dof"]:
    """J^T J of every frame; that of a neighbour where a frame was looked at but not refined."""
    nothing = np.zeros(2 * results[0].deviation.shape, np.float32)
    own = [h if h is None or np.isfinite(h).all() else None for h in (result.hessian for result in results)]
    found = []
    for index, (result, hessian) in enumerate(zip(results, own, strict=True)):
        next_to = [own[n] for n in (index + 1, index - 1) if 0 <= n < len(own) and own[n] is not None]
        if hessian is None and result.energy and next_to:
            hessian = next_to[0]
        found.append(nothing if hessian is None else np.asarray(hessian, np.float32))
    return np.stack(found)


@cached_jit
def _covariances(
    skeleton: Skeleton,
    poses: Pose,
    hessians: Float[Array, "frame dof dof"],
    deviations: Float[Array, "frame dof"],
    settings: UncertaintySettings,
) -> Float[Array, "frame landmark 3 3"]:
    root, angles = jnp.full(ROOT_DOFS, settings.free_root), jnp.full(skeleton.num_angles, settings.free_angle)
    free = jnp.concatenate([root, angles])

    def one(pose: Pose, hessian: Array, deviation: Array) -> Array:
        scaled = free[:, None] * hessian * free[None, :] / settings.correlated
        inverse = jnp.linalg.inv(scaled + jnp.eye(skeleton.num_dofs))
        covariance = free[:, None] * inverse * free[None, :] + jnp.diag((settings.particles * deviation) ** 2)
        moves = jax.jacfwd(lambda step: landmark_positions(skeleton, retract(skeleton, pose, step)))(
            jnp.zeros_like(free)
        )
        return jnp.einsum("jad,de,jbe->jab", moves, 0.5 * (covariance + covariance.T), moves, precision="highest")

    return jax.lax.map(lambda args: one(*args), (poses, hessians, deviations))
