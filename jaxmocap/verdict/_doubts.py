"""Which frames are not to be trusted, and why: how likely they are wrong, and what all frames together say."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ._features import runs, steadied
from ._frame_verdict import FrameResult, VerdictSettings
from ._model import FRAME_MODEL, probability

APART = (
    "the views do not show the same body there; see whether a camera stood still or was pushed (check), and whether "
    "the offsets (sync), the calibration and the actor are right"
)
OUTLINE = (
    "the body covers what looks like the background, or leaves uncovered what does not; look at the overlay, and "
    "select a frame there"
)
UNEXPLAINED = "the covered pixels do not look like the person; look at the overlay, and select a frame there"
FAST = "the body moves implausibly fast; look at the overlay"
UNTOLD = (
    "the pictures tell too little of where the joints are, as where a single camera shows them: it does not see how "
    "far away they are; film with another one, 15 to 45 degrees beside it"
)
ALONE = (
    "no two views can be compared, for a single one shows the person or they are more than 45 degrees apart, and the "
    "pictures leave some doubt; look at the overlay, or film with another one in between"
)
REGISTERED = (
    "the pose at a selected frame is not to be trusted, and everything rests on it: look at the cameras, the offsets, "
    "the actor and the keypoints"
)
_REASONS = {
    APART: ("view gap", "wide view gap"),
    OUTLINE: ("outline",),
    UNEXPLAINED: ("cost",),
    ALONE: ("alone", "wide apart"),
}


@dataclass(frozen=True)
class Doubt:
    """Frames `first` to `last` are not to be trusted, and why."""

    first: int
    last: int
    why: str


def doubts(
    results: Sequence[FrameResult],
    features: Float[np.ndarray, "frame feature"],
    settings: VerdictSettings,
    registered: Collection[int] = (),
    deviations: Float[np.ndarray, "frame"] | None = None,
) -> list[Doubt]:
    """List the spans of frames that are not to be trusted, in order, each frame in one of them.

    These are frames that are wrong with a probability (`FRAME_MODEL`, of their `features`) above `settings.risk`, for
    the reason that makes most of it in a span; whose root is too fast; and where the pictures tell too little:
    `deviations` are the standard deviations of a joint along one axis, median over the body, in metres, where they are
    known. Where half of the `registered` frames are doubtful, so are all frames that lie nearest to one of these.
    Frames that were passed over show nothing themselves and are left out.
    """
    looked_at = np.array([bool(result.energy) for result in results])
    risky = looked_at & (probability(FRAME_MODEL.logit(features)) > settings.risk)
    fast = looked_at & np.array([result.status == "doubtful" for result in results])
    why = np.full(len(results), "", object)
    if deviations is not None and looked_at.any():
        told = np.where(looked_at, deviations, np.median(deviations[looked_at]))
        why[looked_at & (steadied(told, settings.steady) > settings.joint_deviation)] = UNTOLD
    why[fast] = FAST
    parts = FRAME_MODEL.reasons(features)
    for first, stop in runs(risky):
        shares = {reason: sum(parts[name][first:stop].sum() for name in of) for reason, of in _REASONS.items()}
        why[first:stop] = max(shares, key=lambda reason: shares[reason])
    lost = np.array([result.status == "lost" for result in results])
    known = looked_at & np.isin([result.frame for result in results], list(registered))
    wrong = lost | (why != "")
    if known.any() and wrong[known].mean() >= 0.5:
        at = np.flatnonzero(known)
        nearest = at[np.abs(np.arange(len(results))[:, None] - at).argmin(axis=1)]
        why[looked_at & ~wrong & wrong[nearest]] = REGISTERED
    found = [
        Doubt(results[first].frame, results[stop - 1].frame, reason)
        for reason in dict.fromkeys(why[why != ""].tolist())
        for first, stop in runs(why == reason)
    ]
    return sorted(found, key=lambda span: span.first)
