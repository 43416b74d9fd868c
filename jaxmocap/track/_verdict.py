"""Which frames are not to be trusted, and why: what single frames show, steadied over their neighbours, and what all
frames together say."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from ._confidence import VerdictSettings
from ._frame_result import FrameResult
from ._lost import runs

APART = (
    "the views do not show the same body there: the calibration, the offsets or the actor are wrong, a camera stood "
    "still, or the body is elsewhere"
)
OUTLINE = "the body covers what looks like the background, or leaves uncovered what does not"
UNEXPLAINED = (
    "the covered pixels do not look like the person, part of the person stays uncovered, or the body moves "
    "implausibly fast"
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


def doubts(results: Sequence[FrameResult], settings: VerdictSettings, registered: Collection[int] = ()) -> list[Doubt]:
    """The spans of frames that are not to be trusted, in order; one frame may be in several. Frames that were passed
    over show nothing themselves and are left out. Where half of the `registered` frames among them are doubtful, all
    are."""
    looked_at = np.array([bool(result.energy) for result in results])
    marked = {
        APART: _median(_apart(results, settings), settings.steady) > 0.5,
        OUTLINE: _median(_outline(results), settings.steady) > settings.outline,
        UNEXPLAINED: looked_at & np.array([result.status == "doubtful" for result in results]),
    }
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


def with_doubts(results: Sequence[FrameResult], found: Sequence[Doubt], settings: VerdictSettings) -> list[FrameResult]:
    """The results with frames that are not to be trusted "doubtful", if not "lost", and their confidence at most
    `settings.confidence`."""
    judged = []
    for result in results:
        if any(doubt.first <= result.frame <= doubt.last for doubt in found) and result.energy:
            confidence = np.minimum(result.confidence, settings.confidence)
            status = "doubtful" if result.status == "ok" else result.status
            result = replace(result, status=status, confidence=confidence)
        judged.append(result)
    return judged


def _apart(results: Sequence[FrameResult], settings: VerdictSettings) -> Float[np.ndarray, "frame"]:
    """1 where half of the pairs of views, or more, are apart or show too little that is the same."""
    marked = np.zeros(len(results))
    for index, result in enumerate(results):
        if result.signals is not None and np.isfinite(result.signals.matched).any():
            known = np.isfinite(result.signals.matched)
            gaps, matched = result.signals.view_gaps[known], result.signals.matched[known]
            marked[index] = (~(gaps <= settings.view_gap) | (matched < settings.matched)).mean() >= 0.5
    return marked


def _outline(results: Sequence[FrameResult]) -> Float[np.ndarray, "frame"]:
    """How much of the body is beside the person and how much of the person beside the body, mean over the views; 0 in
    frames that were not looked at."""
    signals = [result.signals for result in results]
    return np.array([0.0 if s is None else float((s.bare + s.uncovered).mean()) for s in signals])


def _median(values: Float[np.ndarray, "frame"], window: int) -> Float[np.ndarray, "frame"]:
    """Of the frames around each: what one frame of many shows is chance."""
    reach = window // 2
    padded = np.pad(values, reach, mode="edge")
    return np.median(np.lib.stride_tricks.sliding_window_view(padded, 2 * reach + 1), axis=1)
