"""How the person has moved up to a frame: what the motion prior predicts from."""

from typing import Literal, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxmocap.character import ROOT_DOFS, Pose, Skeleton, away_from_limits, difference, nearest_equivalent

from ._autoregression import predict_difference

AngleChoice = Literal["same", "away_from_limits"]
"""Whether a ball joint keeps its set of angles from frame to frame, or takes the one with more room."""


WINDOW = 30
"""Increments that the autoregression sees."""


class MotionHistory(NamedTuple):
    """Time in seconds and pose of the last tracked frame, the increments (dof,) that led to it, oldest first, and how
    many frames later the next one is: more than 1 after frames that were passed over."""

    timestamp: float
    pose: Pose
    increments: tuple[Float[np.ndarray, "dof"], ...] = ()
    steps: int = 1

    def predicted(self, mode) -> Float[np.ndarray, "dof"]:
        """The increment to the next frame by the autoregression of Eq. 10."""
        num_dofs = ROOT_DOFS + self.pose.angles.shape[0]
        if not self.increments:
            return np.zeros(num_dofs)
        window = np.zeros((WINDOW, num_dofs), np.float32)
        window[-len(self.increments) :] = np.stack(self.increments)
        return self.steps * np.asarray(predict_difference(jnp.asarray(window), len(self.increments), mode))

    def pace(self, fps: float) -> float:
        """Speed of the fastest joint in metres per second at 0.4 m from its axis, held between 0.5 and 2; 1 when
        nothing is known."""
        if not self.increments:
            return 1.0
        return float(np.clip(np.abs(self.increments[-1][ROOT_DOFS:]).max() * 0.4 * max(fps, 1e-3), 0.5, 2.0))


def after(
    skeleton: Skeleton, history: MotionHistory | None, timestamp: float, pose: Pose, angles: AngleChoice
) -> MotionHistory:
    """The history of the frame that follows one with this pose."""
    increments = ()
    if history is not None:
        before = nearest_equivalent(skeleton, history.pose, pose) if angles == "away_from_limits" else history.pose
        step = np.asarray(difference(skeleton, before, pose)) / history.steps
        increments = (*history.increments, *[step] * history.steps)[-WINDOW:]
    return MotionHistory(
        timestamp, away_from_limits(skeleton, pose) if angles == "away_from_limits" else pose, increments
    )
