"""What all frames together say of a result: which frames and limbs to trust, and which cameras to leave out."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from jaxmocap.character import Skeleton

from . import _doubts, _lost, _outlier_camera
from ._doubts import ALONE, UNTOLD, Doubt, doubts
from ._features import frame_features, limb_features
from ._frame_verdict import FrameResult, VerdictSettings
from ._lost import LostSpan, lost_spans
from ._model import FRAME_MODEL, LIMB_MODEL, probability
from ._outlier_camera import OutlierCamera, contradicted, outlier_cameras
from ._uncertainty import usual_deviations

GUIDE_ENTRIES = {
    _doubts.APART: "The views disagree",
    _doubts.OUTLINE: "The outline does not fit",
    _doubts.UNEXPLAINED: "The pixels do not look like the person",
    _doubts.FAST: "The body moves too fast",
    _doubts.UNTOLD: "The pictures tell too little",
    _doubts.ALONE: "No two views can be compared",
    _doubts.REGISTERED: "A selected frame is wrong",
    _lost.LOST: "The body is lost",
    _lost.HIDDEN: "No view shows a limb",
    _lost.FOREIGN: "A limb looks like the background",
    _lost.JUMPING: "A limb leaves its way",
    _outlier_camera.ALONE: "A camera is left out",
}
"""Heading of `docs/guide.md` that explains a reason, by reason as `why` of a span has it."""


@dataclass(frozen=True)
class SequenceVerdict:
    """The verdict on a tracked sequence; spans are in positions of the capture.

    Attributes:
        status: of every frame, "ok", "doubtful" or "lost".
        confidence: of every landmark in every frame, 0 to 1.
        risk: probability that a frame is wrong, its joints more than 8 cm off in the mean.
        limb_risk: probability that a limb is, more than 15 cm.
        doubts: spans of frames that are not to be trusted, and why.
        lost: spans in which the body or a limb is lost, and why.
        outlier_cameras: spans in which a camera shows the body elsewhere than the others, which alone are judged by
            then.
    """

    status: list[str]
    confidence: Float[np.ndarray, "frame landmark"]
    risk: Float[np.ndarray, "frame"]
    limb_risk: Float[np.ndarray, "frame limb"]
    doubts: list[Doubt]
    lost: list[LostSpan]
    outlier_cameras: list[OutlierCamera]


def judge_sequence(
    results: Sequence[FrameResult],
    skeleton: Skeleton,
    settings: VerdictSettings,
    registered: Collection[int] = (),
    cameras: Sequence[str] = (),
) -> SequenceVerdict:
    """Judge the frames of a sequence together. `registered` are the selected frames, `cameras` the cameras' names."""
    features = frame_features(results, ~contradicted(results, settings), settings)
    logit = FRAME_MODEL.logit(features)
    of_limbs = limb_features(results, skeleton, logit)
    found = doubts(results, features, settings, registered, usual_deviations(skeleton, results))
    trust = [_trust(result, found, settings) for result in results]
    doubtful = np.array([status != "ok" for status, _ in trust])
    lost = lost_spans(results, skeleton, of_limbs, doubtful, settings)
    return SequenceVerdict(
        [status for status, _ in trust],
        np.stack(
            [
                without_lost(confidence, result.frame, lost, skeleton)
                for result, (_, confidence) in zip(results, trust, strict=True)
            ]
        ),
        probability(logit),
        probability(LIMB_MODEL.logit(of_limbs)),
        found,
        lost,
        outlier_cameras(results, settings, cameras),
    )


def _trust(
    result: FrameResult, found: Sequence[Doubt], settings: VerdictSettings
) -> tuple[str, Float[np.ndarray, "landmark"]]:
    """Status and confidence of a frame: "doubtful", if not "lost", where a doubt holds, with a confidence of at most
    `settings.confidence` unless it is only that the pictures tell too little, or cannot be compared."""
    reasons = {doubt.why for doubt in found if doubt.first <= result.frame <= doubt.last}
    if reasons and result.energy:
        most = 1.0 if reasons <= {ALONE, UNTOLD} else settings.confidence
        return "doubtful" if result.status == "ok" else result.status, np.minimum(result.confidence, most)
    return result.status, result.confidence


def without_lost(
    confidence: Float[np.ndarray, "landmark"], frame: int, spans: Sequence[LostSpan], skeleton: Skeleton
) -> Float[np.ndarray, "landmark"]:
    """Set the confidence of a frame's landmarks to 0 for parts that are lost there."""
    groups = {label: name for name, label in skeleton.limb_labels.items()}
    for span in spans:
        if span.first <= frame <= span.last:
            moved = skeleton.bodies_of(groups.get(span.part, "root"))  # the root moves them all
            confidence = np.where(moved[list(skeleton.landmark_bodies)], 0.0, confidence)
    return confidence
