"""Where the body or a limb was lost: spans of frames with a reason, for the report and for whoever reads it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from jaxmocap.character import Skeleton

from ._features import runs
from ._frame_verdict import FrameResult, VerdictSettings
from ._model import LIMB_MODEL, probability

HIDDEN, FOREIGN, JUMPING = "no view shows it", "its pixels look like the background", "it leaves its way"
_REASONS = {HIDDEN: "unseen", FOREIGN: "cost", JUMPING: "leap"}
LOST = "the body's pixels look like the background, or it moves too fast"


@dataclass(frozen=True)
class LostSpan:
    """A part, "body" or a limb such as "left arm", that is not to be trusted in frames `first` to `last`, and why."""

    part: str
    first: int
    last: int
    why: str


def lost_spans(
    results: Sequence[FrameResult],
    skeleton: Skeleton,
    features: Float[np.ndarray, "frame limb feature"],
    doubtful: Bool[np.ndarray, "frame"],
    settings: VerdictSettings,
) -> list[LostSpan]:
    """List the spans in which the whole body is lost, and in which a limb is.

    A limb is lost where no view shows its outer half, or where it is wrong with a probability (`LIMB_MODEL`, of its
    `features`) above `settings.limb_risk`, for the reason that makes most of it; where that is only that the whole
    frame is `doubtful`, it is not listed.
    """
    body = np.array([result.status == "lost" for result in results])
    spans = _spans(results, body, "body", LOST)
    hidden = np.stack([result.limb_seen < settings.hidden for result in results])
    risky = probability(LIMB_MODEL.logit(features)) > settings.limb_risk
    parts = LIMB_MODEL.reasons(features)
    shares = np.stack([parts[name] for name in _REASONS.values()])
    risky &= (shares.max(axis=0) > parts["frame"]) | ~doubtful[:, None]
    most = np.where(hidden, list(_REASONS).index(HIDDEN), shares.argmax(axis=0))
    listed = (risky | hidden) & ~body[:, None]
    for limb, name in enumerate(skeleton.limb_labels.values()):
        for number, why in enumerate(_REASONS):
            spans += _spans(results, listed[:, limb] & (most[:, limb] == number), name, why)
    return sorted(spans, key=lambda span: (span.first, span.part))


def _spans(results: Sequence[FrameResult], marked: Bool[np.ndarray, "frame"], part: str, why: str) -> list[LostSpan]:
    return [LostSpan(part, results[first].frame, results[stop - 1].frame, why) for first, stop in runs(marked)]
