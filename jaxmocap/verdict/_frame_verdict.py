"""How far a frame's answer may be trusted: from the pixels it explains, limb by limb."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from jaxmocap.character import Character


@dataclass(frozen=True)
class Verdict:
    """`confidence` per landmark in [0, 1], and "ok", "doubtful" or "lost"."""

    confidence: Float[np.ndarray, "landmark"]
    status: str
    covered_cost: float


@dataclass(frozen=True)
class VerdictSettings:
    """Mean cost of Eq. 6 over the covered pixels (0 explains them, 0.5 says nothing, 1 is background): above
    `doubtful` or `lost`, or when the body moves faster than `top_speed` metres per second, the frame is called so; it
    is doubtful, too, when more than `uncovered` of the person's pixels look foreign but are not covered, as an arm that
    was lost. A limb is lost when less than `hidden` of its outer half is seen in any view, when the mean cost of that
    half is above `foreign`, or when it is more than `limb_deviation` metres from halfway between the frames before and
    after, an acceleration above `acceleration_limit` metres per second squared.

    A frame is doubtful, too, when half of the pairs of cameras, or more, do not show the same body there: what the two
    show of its surface lies, in the median over the surface, more than `view_gap` metres apart, or is the same in less
    than `matched` of it; when the background that the body covers and the person that it does not are more than
    `outline` of the body, mean over the views, as an arm and a half; and when the standard deviation of a joint's
    place, mean over the body, is more than `joint_deviation` metres, as where one camera does not tell how far away it
    is; all in the median of `steady` frames. A camera that agrees with no other, where others agree, is left out of all of
    it. When half of the selected frames are doubtful all are, for everything rests on them. Doubtful frames have at
    most `confidence`, but for those of which only the deviation is large: their pixels are explained."""

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


def judge(
    character: Character,
    face_bodies: Int[np.ndarray, "face"],
    ids: Int[np.ndarray, "camera height width"],
    costs: Float[np.ndarray, "camera height width"],
    speed: float,
    settings: VerdictSettings,
    uncovered: float = 0.0,
) -> Verdict:
    """Verdict of a frame from its face ids, pixel costs, and the share of the person left uncovered.

    A body seen in fewer than `least_pixels` pixels takes the confidence of the nearest ancestor that is seen.
    """
    covered = ids >= 0
    bodies = len(character.skeleton.body_names)
    if not covered.any():
        return Verdict(np.zeros(len(character.skeleton.landmark_names)), "lost", 1.0)
    body = face_bodies[ids[covered]]
    count = np.bincount(body, minlength=bodies)
    cost = np.bincount(body, weights=costs[covered], minlength=bodies) / np.maximum(count, 1)
    confidence = np.clip(1.25 - 1.75 * cost, 0.0, 1.0)
    overall = float(costs[covered].mean())
    general = float(np.clip(1.25 - 1.75 * overall, 0.0, 1.0))
    for index, parent in enumerate(character.skeleton.parents):
        if count[index] < settings.least_pixels:
            confidence[index] = confidence[parent] if parent >= 0 else general
    status = "ok"
    if overall > settings.lost or speed > 2 * settings.top_speed:
        status = "lost"
    elif overall > settings.doubtful or speed > settings.top_speed or uncovered > settings.uncovered:
        status = "doubtful"
    return Verdict(confidence[list(character.skeleton.landmark_bodies)], status, overall)
