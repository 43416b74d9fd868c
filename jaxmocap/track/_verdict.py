"""Which frames are not to be trusted, and why: what single frames show, steadied over their neighbours, and what all
frames together say."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from ._confidence import VerdictSettings
from ._frame_result import FrameResult
from ._lost import runs

APART = (
    "the views do not show the same body there: the calibration, the offsets or the actor are wrong, a camera stood "
    "still, or the body is elsewhere"
)
BARE = "the body covers what looks like the background"
UNEXPLAINED = (
    "the covered pixels do not look like the person, part of the person stays uncovered, or the body moves "
    "implausibly fast"
)
MOST = "most of the frames cannot be trusted, so what is wrong is wrong everywhere"


@dataclass(frozen=True)
class Doubt:
    """Frames `first` to `last` are not to be trusted, and why."""

    first: int
    last: int
    why: str


def doubts(results: Sequence[FrameResult], settings: VerdictSettings) -> list[Doubt]:
    """The spans of frames that are not to be trusted, in order; one frame may be in several. Frames that were passed
    over show nothing themselves and are left out."""
    looked_at = np.array([bool(result.energy) for result in results])
    lost = looked_at & np.array([result.status == "lost" for result in results])
    marked = {
        APART: _steady(_apart(results, settings), settings.steady),
        BARE: _steady(_share(results, "bare") > settings.bare, settings.steady),
        UNEXPLAINED: looked_at & np.array([result.status == "doubtful" for result in results]),
    }
    some = np.any([lost, *marked.values()], axis=0)
    if some.sum() > settings.most * max(looked_at.sum(), 1):
        marked[MOST] = looked_at & ~some
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


def _apart(results: Sequence[FrameResult], settings: VerdictSettings) -> Bool[np.ndarray, "frame"]:
    """Where half of the pairs of views, or more, are apart or show too little that is the same."""
    marked = []
    for result in results:
        if result.signals is None or not np.isfinite(result.signals.matched).any():
            marked.append(False)
            continue
        known = np.isfinite(result.signals.matched)
        gaps, matched = result.signals.view_gaps[known], result.signals.matched[known]
        bad = ~(gaps <= settings.view_gap) | (matched < settings.matched)
        marked.append(bool(bad.mean() >= 0.5))
    return np.array(marked, bool)


def _share(results: Sequence[FrameResult], name: str) -> Float[np.ndarray, "frame"]:
    """A signal in the view where it is largest; 0 in frames that were not looked at."""
    return np.array([0.0 if r.signals is None else float(np.max(getattr(r.signals, name))) for r in results])


def _steady(marked: Bool[np.ndarray, "frame"], window: int) -> Bool[np.ndarray, "frame"]:
    """Whether most of the frames around each are marked: one frame of many is chance, and so is one that is not."""
    reach = window // 2
    padded = np.pad(marked.astype(float), reach, mode="edge")
    return np.convolve(padded, np.ones(2 * reach + 1), "valid") > reach + 0.5
