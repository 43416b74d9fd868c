"""What is known of a frame afterwards; and of one that could not be looked at."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from jaxmocap.character import Pose, Skeleton, difference, nearest_equivalent, retract
from jaxmocap.observation import FrameImages

from ._signals import FrameSignals


@dataclass
class FrameResult:
    """What was found in one frame: the pose, the energies of Eq. 5 by term, how far it may be trusted, the deviation
    of the last particles (39,), the J^T J of the refinement, seconds by stage, and of each limb's outer half the mean
    cost of Eq. 6 (NaN where it is not seen) and the share seen in some view; and the signals of the verdict, where it
    was looked at."""

    frame: int
    timestamp: float
    pose: Pose
    energy: dict[str, float]
    confidence: Float[np.ndarray, "landmark"]
    status: str
    deviation: Float[np.ndarray, "dof"]
    hessian: Float[np.ndarray, "dof dof"] | None
    seconds: dict[str, float]
    limb_costs: Float[np.ndarray, "limb"]
    limb_seen: Float[np.ndarray, "limb"]
    signals: FrameSignals | None = None


def passed_over(skeleton: Skeleton, shown: FrameImages, pose: Pose, limbs: int) -> FrameResult:
    """A frame that was not looked at: it has a pose, nothing that speaks for it, and is doubtful."""
    unknown, confidence = np.full(limbs, np.nan), np.zeros(len(skeleton.landmark_names))
    return FrameResult(
        shown.frame, shown.timestamp, pose, {}, confidence, "doubtful", np.zeros(39), None, {}, unknown, unknown
    )


def between(skeleton: Skeleton, results: Sequence[FrameResult], later: Pose) -> list[FrameResult]:
    """Frames passed over in a row, which have the pose of the frame before, evenly on the way from there to a later
    pose."""
    earlier, steps = results[0].pose, len(results) + 1
    way = difference(skeleton, earlier, nearest_equivalent(skeleton, later, earlier))
    poses = [retract(skeleton, earlier, way * (number / steps)) for number in range(1, steps)]
    return [replace(result, pose=pose) for result, pose in zip(results, poses, strict=True)]
