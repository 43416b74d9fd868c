"""What is known of a frame: how far its answer may be trusted, by the pixels it explains, and the record of it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from jaxmocap.character import Pose, Skeleton, difference, nearest_equivalent, retract
from jaxmocap.observation import FrameImages
from jaxmocap.search import DrawnPose, Evidence

from ._signals import FrameSignals

LEAST_PIXELS = 30
"""Pixels of a body below which its confidence is that of the nearest ancestor with more."""


@dataclass(frozen=True)
class VerdictSettings:
    """When frames and limbs are called doubtful or lost; not in the paper. Costs are those of Eq. 6, mean over pixels:
    0 explains them, 0.5 says nothing, 1 is background.

    Attributes:
        risk: probability of being wrong (8 cm off in the mean over the joints) above which a frame is doubtful.
        limb_risk: probability of being wrong (15 cm off) above which a limb is lost,
        hidden: or when less than this share of its outer half is seen in any view.
        joint_deviation: metres that a joint's standard deviation along one axis may be, median over the body.
        lost: cost of the covered pixels above which a frame is lost.
        top_speed: metres per second of the root above which a frame is doubtful, and at twice of which it is lost.
        steady: frames whose median counts for what is measured of a frame, and for cameras that contradict the others.
        confidence: what a landmark of a doubtful frame has at most, unless only the pictures tell too little.
    """

    risk: float = 0.2
    limb_risk: float = 0.3
    hidden: float = 0.25
    joint_deviation: float = 0.009
    lost: float = 0.55
    top_speed: float = 15.0
    steady: int = 5
    confidence: float = 0.25


def judge_frame(
    evidence: Evidence, drawn: DrawnPose, settings: VerdictSettings, speed: float = 0.0
) -> tuple[Float[np.ndarray, "landmark"], str, float]:
    """Judge a frame by its drawn answer and the root's speed in metres per second.

    Returns the confidence of every landmark, 0 to 1, the status, "ok", "doubtful" or "lost", and the mean cost of Eq. 6
    over the covered pixels.
    """
    skeleton, covered = evidence.character.skeleton, drawn.ids >= 0
    bodies = len(skeleton.body_names)
    if not covered.any():
        return np.zeros(len(skeleton.landmark_names)), "lost", 1.0
    body = evidence.face_bodies[drawn.ids[covered]]
    count = np.bincount(body, minlength=bodies)
    cost = np.bincount(body, weights=drawn.costs[covered], minlength=bodies) / np.maximum(count, 1)
    confidence = np.clip(1.25 - 1.75 * cost, 0.0, 1.0)
    overall = float(drawn.costs[covered].mean())
    general = float(np.clip(1.25 - 1.75 * overall, 0.0, 1.0))
    for index, parent in enumerate(skeleton.parents):
        if count[index] < LEAST_PIXELS:
            confidence[index] = confidence[parent] if parent >= 0 else general
    status = "ok"
    if overall > settings.lost or speed > 2 * settings.top_speed:
        status = "lost"
    elif speed > settings.top_speed:
        status = "doubtful"
    return confidence[list(skeleton.landmark_bodies)], status, overall


@dataclass(frozen=True)
class FrameResult:
    """What was found in one frame, never changed afterwards: what all frames together say of it is a `SequenceVerdict`.

    Attributes:
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
    """Record a frame that was not looked at: it has a pose, nothing that speaks for it, and is doubtful."""
    unknown, confidence = np.full(limbs, np.nan), np.zeros(len(skeleton.landmark_names))
    nothing = np.zeros(skeleton.num_dofs)
    return FrameResult(
        shown.frame, shown.timestamp, pose, {}, confidence, "doubtful", nothing, None, {}, unknown, unknown
    )


def poses_between(
    skeleton: Skeleton, results: Sequence[FrameResult], later: Pose, shares: Sequence[float]
) -> list[FrameResult]:
    """Place frames passed over in a row on the way from the pose of the frame before to a later pose: `shares` of the
    time between the two have passed at each."""
    earlier = results[0].pose
    way = difference(skeleton, earlier, nearest_equivalent(skeleton, later, earlier))
    poses = [retract(skeleton, earlier, way * share) for share in shares]
    return [replace(result, pose=pose) for result, pose in zip(results, poses, strict=True)]
