"""What is known of a frame afterwards; and of one that could not be looked at."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from jaxmocap.character import Pose, Skeleton, difference, nearest_equivalent, retract
from jaxmocap.observation import FrameImages

from ._signals import FrameSignals


@dataclass(frozen=True)
class FrameResult:
    """What was found in one frame, never changed afterwards: what all frames together say of it is a `SequenceVerdict`.

    frame: position in the capture.
    timestamp: seconds.
    pose: the answer.
    energy: Eq. 5 by term, and the mean cost of the covered pixels; empty for a frame that was passed over.
    confidence: of every landmark as this frame alone tells it, 0 to 1.
    status: "ok", "doubtful" or "lost", as this frame alone tells it.
    deviation: standard deviation of the last particles, metres and radians.
    hessian: J^T J of the refinement's last step, if there was one.
    seconds: by stage.
    limb_costs: mean cost of Eq. 6 over each limb's distal half, NaN where it is not seen.
    limb_seen: share of each limb's distal half that some view shows.
    signals: what the verdict on the sequence reads, where the frame was looked at.
    """

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
    nothing = np.zeros(skeleton.num_dofs)
    return FrameResult(
        shown.frame, shown.timestamp, pose, {}, confidence, "doubtful", nothing, None, {}, unknown, unknown
    )


def poses_between(skeleton: Skeleton, results: Sequence[FrameResult], later: Pose) -> list[FrameResult]:
    """Frames passed over in a row, which have the pose of the frame before, evenly on the way from there to a later
    pose."""
    earlier, steps = results[0].pose, len(results) + 1
    way = difference(skeleton, earlier, nearest_equivalent(skeleton, later, earlier))
    poses = [retract(skeleton, earlier, way * (number / steps)) for number in range(1, steps)]
    return [replace(result, pose=pose) for result, pose in zip(results, poses, strict=True)]
