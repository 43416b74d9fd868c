"""How far spine, neck and collar bones are bent: what a few views leave undecided, the straighter posture decides."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxmocap._types import Knob, knob
from jaxmocap.character import ROOT_DOFS, Pose, Skeleton
from jaxmocap.observation import FrameProblem


def bend(skeleton: Skeleton, angles: Float[Array, "... angle"]) -> Float[Array, "... angle"]:
    """Angles of spine, neck and collar bones as shares of their limits on the side they bend to; 0 for all others."""
    counts = jnp.asarray(np.isin(np.arange(ROOT_DOFS, skeleton.num_dofs), skeleton.posture).astype(np.float32))
    limit = jnp.where(angles >= 0, skeleton.upper, -skeleton.lower)
    return counts * angles / jnp.maximum(limit, 0.1)


class Posture(eqx.Module):
    """The sum of squared shares of their limits to which spine, neck and collar bones are bent. Not in the paper,
    whose search may explain a pixel by any posture within the limits; without this term in the energy it is back."""

    weight: Knob = knob(0.005)

    name = "posture"

    def score_pose(self, skeleton: Skeleton, pose: Pose, problem: FrameProblem) -> Float[Array, ""]:
        return jnp.sum(bend(skeleton, pose.angles) ** 2)
