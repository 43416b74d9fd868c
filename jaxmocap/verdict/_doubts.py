"""Which frames are not to be trusted, and why: what single frames show, steadied over their neighbours, and what all
frames together say."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from ._frame_verdict import FrameResult, VerdictSettings
from ._lost import runs
from ._outlier_camera import agreement, contradicted, steadied

APART = (
    "the views do not show the same body there: the calibration, the offsets or the actor are wrong, a camera stood "
    "still, or the body is elsewhere"
)


OUTLINE = "the body covers what looks like the background, or leaves uncovered what does not"
UNEXPLAINED = (
    "the covered pixels do not look like the person, part of the person stays uncovered, or the body moves "
    "implausibly fast"
)


UNTOLD = (
    "the pictures tell too little of where the joints are, as where a single camera shows them: it does not see how "
    "far away they are"
)


REGISTERED = (
    "the pose at a selected frame is not to be trusted, and everything rests on it: look at the cameras, the offsets, "
    "the actor and the keypoints"
)


@dataclass(frozen=True)
class Doubt:
    """Frames `first` to `last` are not to be trusted, and why."""

    first: int
    last: int
    why: str


def doubts(
    results: Sequence[FrameResult],
    settings: VerdictSettings,
    registered: Collection[int] = (),
    deviations: Float[np.ndarray, "frame"] | None = None,
) -> list[Doubt]:
    """List the spans of frames that are not to be trusted, in order; one frame may be in several.

    Frames that were passed over show nothing themselves and are left out. Where half of the `registered` frames among
    them are doubtful, all are. Cameras that the others contradict have no say. `deviations` are the standard deviations
    of a joint, mean over the body, in metres, where they are known.
    """
    looked_at = np.array([bool(result.energy) for result in results])
    inlier = ~contradicted(results, settings)
    marked = {
        APART: steadied(_apart(results, inlier, settings), settings.steady) > 0.5,
        OUTLINE: steadied(_outline(results, inlier), settings.steady) > settings.outline,
        UNEXPLAINED: looked_at & _unexplained(results, inlier, settings),
    }
    if deviations is not None:
        marked[UNTOLD] = looked_at & (steadied(deviations, settings.steady) > settings.joint_deviation)
    lost = np.array([result.status == "lost" for result in results])
    some = np.any(np.stack([lost, *marked.values()]), axis=0)
    known = looked_at & np.isin([result.frame for result in results], list(registered))
    if known.any() and some[known].mean() >= 0.5:
        marked[REGISTERED] = looked_at & ~some
    found = [
        Doubt(results[first].frame, results[stop - 1].frame, why)
        for why, frames in marked.items()
        for first, stop in runs(frames)
    ]
    return sorted(found, key=lambda span: (span.first, span.why))


def _apart(
    results: Sequence[FrameResult], inlier: Bool[np.ndarray, "frame camera"], settings: VerdictSettings
) -> Float[np.ndarray, "frame"]:
    """1 where half of the pairs of views, or more, are apart or show too little that is the same."""
    marked = np.zeros(len(results))
    for index, result in enumerate(results):
        if result.signals is not None:
            known, agree = agreement(result.signals, settings)
            known &= inlier[index][:, None] & inlier[index]
            marked[index] = known.any() and agree[known].mean() <= 0.5
    return marked


def _outline(results: Sequence[FrameResult], inlier: Bool[np.ndarray, "frame camera"]) -> Float[np.ndarray, "frame"]:
    """How much of the body is beside the person and how much of the person beside the body, mean over the views; 0 in
    frames that were not looked at."""
    signals = [result.signals for result in results]
    return np.array(
        [0.0 if s is None else float((s.bare + s.uncovered)[of].mean()) for s, of in zip(signals, inlier, strict=True)]
    )


def _unexplained(
    results: Sequence[FrameResult], inlier: Bool[np.ndarray, "frame camera"], settings: VerdictSettings
) -> Bool[np.ndarray, "frame"]:
    """Where `judge` calls the frame doubtful and, if not all cameras are inlier, those that are do too."""
    doubtful = np.array([result.status == "doubtful" for result in results], bool)
    for index in np.flatnonzero(doubtful & ~np.all(inlier, axis=1)).tolist():
        signals = results[index].signals
        if signals is None:
            continue
        costs, uncovered = signals.costs[inlier[index]].mean(), signals.uncovered[inlier[index]].max()
        doubtful[index] = (
            costs > settings.doubtful or uncovered > settings.uncovered or signals.speed > settings.top_speed
        )
    return doubtful
