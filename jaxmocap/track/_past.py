"""What is known when a frame begins."""

from typing import Literal, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxmocap.character import Pose, Skeleton, beside, difference, roomier
from jaxmocap.motion import predict_difference
from jaxmocap.observation import FrameImages

AngleChoice = Literal["same", "roomier"]
"""Whether a ball joint keeps its set of angles from frame to frame, or takes the one with more room."""
WINDOW = 30
"""Increments that the autoregression sees."""


class Past(NamedTuple):
    """The last frame that was tracked, its pose, the increments (39,) that led to it, oldest first, and how many frames
    later the next one is: more than 1 after frames that were passed over."""

    shown: FrameImages
    pose: Pose
    increments: tuple[Float[np.ndarray, "dof"], ...] = ()
    steps: int = 1

    def predicted(self, mode) -> Float[np.ndarray, "dof"]:
        """The increment to the next frame by the autoregression of Eq. 10."""
        if not self.increments:
            return np.zeros(39)
        window = np.zeros((WINDOW, 39), np.float32)
        window[-len(self.increments) :] = np.stack(self.increments)
        return self.steps * np.asarray(predict_difference(jnp.asarray(window), len(self.increments), mode))

    def pace(self, fps: float) -> float:
        """Speed of the fastest joint in metres per second at 0.4 m from its axis, held between 0.5 and 2; 1 when
        nothing is known."""
        if not self.increments:
            return 1.0
        return float(np.clip(np.abs(self.increments[-1][6:]).max() * 0.4 * max(fps, 1e-3), 0.5, 2.0))


def after(skeleton: Skeleton, past: Past | None, shown: FrameImages, pose: Pose, angles: AngleChoice) -> Past:
    """The past of the frame that follows `shown`."""
    increments = ()
    if past is not None:
        before = beside(skeleton, past.pose, pose) if angles == "roomier" else past.pose
        step = np.asarray(difference(skeleton, before, pose)) / past.steps
        increments = (*past.increments, *[step] * past.steps)[-WINDOW:]
    return Past(shown, roomier(skeleton, pose) if angles == "roomier" else pose, increments)
