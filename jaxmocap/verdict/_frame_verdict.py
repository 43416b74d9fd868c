"""How far a frame's answer may be trusted: from the pixels it explains, limb by limb."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from jaxmocap.search import DrawnPose, Evidence


@dataclass(frozen=True)
class FrameVerdict:
    """What a frame says of itself.

    confidence: of every landmark, 0 to 1.
    status: "ok", "doubtful" or "lost".
    covered_cost: mean cost of Eq. 6 over the covered pixels.
    """

    confidence: Float[np.ndarray, "landmark"]
    status: str
    covered_cost: float


@dataclass(frozen=True)
class VerdictSettings:
    """Where frames and limbs are called doubtful or lost; not in the paper. Costs are those of Eq. 6, mean over pixels:
    0 explains them, 0.5 says nothing, 1 is background. Chosen beside three captures (`benchmarks/verdicts.py`).

    doubtful: cost of the covered pixels above which a frame is doubtful.
    lost: cost above which it is lost.
    top_speed: metres per second of the root above which a frame is doubtful, and at twice of which it is lost.
    uncovered: share of the person that may look foreign and stay uncovered, as an arm that was lost does.
    least_pixels: pixels of a body below which its confidence is that of the nearest ancestor with more.
    hidden: a limb is lost when less than this share of its distal half is seen in any view,
    foreign: or when the cost of that half is above this,
    limb_deviation: or when it is more metres than this from halfway between the frames before and after,
    acceleration_limit: at an acceleration above this, metres per second squared.
    view_gap: metres that two views may show the body's surface apart, in the median over it.
    matched: share of the surface at which two views have to show the same.
    outline: background covered and person not covered, as a share of the body, mean over the views: an arm and a half.
    joint_deviation: metres that a joint's standard deviation may be, mean over the body.
    steady: frames whose median counts for the last four, and for cameras that contradict the others.
    confidence: what a landmark of a doubtful frame has at most, unless only `joint_deviation` is the reason.
    """

    doubtful: float = 0.42
    lost: float = 0.55
    top_speed: float = 15.0
    uncovered: float = 0.06
    least_pixels: int = 30
    hidden: float = 0.25
    foreign: float = 0.7
    limb_deviation: float = 0.33
    acceleration_limit: float = 300.0
    view_gap: float = 0.01
    matched: float = 0.25
    outline: float = 0.07
    joint_deviation: float = 0.03
    steady: int = 5
    confidence: float = 0.25


def judge_frame(
    evidence: Evidence, drawn: DrawnPose, settings: VerdictSettings, speed: float = 0.0, uncovered: float = 0.0
) -> FrameVerdict:
    """Judge a frame by its drawn answer, the root's speed in metres per second and the share of the person that is left
    uncovered."""
    skeleton, covered = evidence.character.skeleton, drawn.ids >= 0
    bodies = len(skeleton.body_names)
    if not covered.any():
        return FrameVerdict(np.zeros(len(skeleton.landmark_names)), "lost", 1.0)
    body = evidence.face_bodies[drawn.ids[covered]]
    count = np.bincount(body, minlength=bodies)
    cost = np.bincount(body, weights=drawn.costs[covered], minlength=bodies) / np.maximum(count, 1)
    confidence = np.clip(1.25 - 1.75 * cost, 0.0, 1.0)
    overall = float(drawn.costs[covered].mean())
    general = float(np.clip(1.25 - 1.75 * overall, 0.0, 1.0))
    for index, parent in enumerate(skeleton.parents):
        if count[index] < settings.least_pixels:
            confidence[index] = confidence[parent] if parent >= 0 else general
    status = "ok"
    if overall > settings.lost or speed > 2 * settings.top_speed:
        status = "lost"
    elif overall > settings.doubtful or speed > settings.top_speed or uncovered > settings.uncovered:
        status = "doubtful"
    return FrameVerdict(confidence[list(skeleton.landmark_bodies)], status, overall)
