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
        scale: factor on the deviations that the pictures tell.
        doubt: of a landmark without confidence they are 1 + `doubt` times as large.
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

    What the pictures do not tell, an arm behind the body, has the deviation it has when free. Frames that were not
    refined, where tracking began or that were passed over, take the J^T J of the nearest that was.
    """
    settings = UncertaintySettings() if settings is None else settings
    free = np.array([settings.free_root] * ROOT_DOFS + [settings.free_angle] * skeleton.num_angles)
    # Along each direction the pictures tell `told` times what is known without them, whose deviation is `free`.
    told, directions = np.linalg.eigh(free[:, None] * _hessians(results) * free / settings.correlated)
    along = free[:, None] * directions
    deviations = settings.particles * np.stack([np.asarray(result.deviation, np.float32) for result in results])
    poses = Pose(
        jax.device_put(np.stack([r.pose.root for r in results])),
        jax.device_put(np.stack([r.pose.angles for r in results])),
    )
    trusted = [result.confidence for result in results] if confidence is None else confidence
    doubt = 1 - np.stack([np.asarray(row, np.float32) for row in trusted])
    factors = (settings.scale * (1 + settings.doubt * doubt)) ** 2
    arrays = (np.maximum(told, 0.0), along, deviations, factors)
    told, along, deviations, factors = jax.device_put(tuple(np.asarray(array, np.float32) for array in arrays))
    found = _covariances(skeleton, poses, told, along, deviations, factors)
    return np.asarray(found) + (settings.floor**2 + misfit**2) * np.eye(3, dtype=np.float32)


def usual_deviations(skeleton: Skeleton, results: Sequence[FrameResult]) -> Float[np.ndarray, "frame"] | None:
    """Find the standard deviation of a joint's place that half of the landmarks have at most, metres, along one axis.

    It is that of full confidence, and none of a limb that no view shows. None where nothing was refined.
    """
    if all(result.hessian is None for result in results):
        return None
    settings = UncertaintySettings(doubt=0.0)
    variances = np.trace(joint_covariances(skeleton, results, settings), axis1=-2, axis2=-1)
    return np.median(np.sqrt(variances / 3), axis=1)


def _hessians(results: Sequence[FrameResult]) -> Float[np.ndarray, "frame dof dof"]:
    """J^T J of every frame, or of the nearest that has one."""
    known = [
        index
        for index, result in enumerate(results)
        if result.hessian is not None and np.isfinite(result.hessian).all()
    ]
    if not known:
        return np.zeros((len(results), *2 * results[0].deviation.shape))
    nearest = np.abs(np.arange(len(results))[:, None] - np.array(known)[::-1]).argmin(axis=1)  # the later of two
    return np.stack([np.asarray(results[known[::-1][place]].hessian, float) for place in nearest])


@cached_jit
def _covariances(
    skeleton: Skeleton,
    poses: Pose,
    told: Float[Array, "frame direction"],
    along: Float[Array, "frame dof direction"],
    deviations: Float[Array, "frame dof"],
    factors: Float[Array, "frame landmark"],
) -> Float[Array, "frame landmark 3 3"]:
    def one(pose: Pose, told: Array, along: Array, deviation: Array, factor: Array) -> Array:
        moves = jax.jacfwd(lambda step: landmark_positions(skeleton, retract(skeleton, pose, step)))(
            jnp.zeros(skeleton.num_dofs)
        )
        of_rows = jnp.einsum("jad,de->jae", moves, along, precision="highest")
        share = factor[:, None] / (told + factor[:, None])
        of_particles = moves * deviation
        spread = jnp.einsum("jae,jbe->jab", of_particles, of_particles, precision="highest")
        rows = jnp.einsum("jae,je,jbe->jab", of_rows, share, of_rows, precision="highest")
        return rows + factor[:, None, None] * spread

    return jax.lax.map(lambda args: one(*args), (poses, told, along, deviations, factors))
