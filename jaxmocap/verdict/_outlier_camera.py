"""Which cameras the others contradict: of three or more, one that stood still, started at another time or was pushed
shows the body elsewhere than those that agree."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool

from ._features import runs, steadied
from ._frame_verdict import FrameResult, VerdictSettings
from ._signals import FrameSignals

ALONE = (
    "it shows the body elsewhere than the others, which agree and by which the result is judged; it stood still, "
    "started at another time, was pushed or is wrongly calibrated"
)

VIEW_GAP = 0.01
"""Metres that two views may show the body's surface apart, in the median over it, and agree."""

MATCHED = 0.25
"""Share of the surface at which two views that agree show the same."""


@dataclass(frozen=True)
class OutlierCamera:
    """In frames `first` to `last` this camera agrees with no other, while others agree with one another."""

    camera: str
    first: int
    last: int
    why: str = ALONE


def outlier_cameras(
    results: Sequence[FrameResult], settings: VerdictSettings, names: Sequence[str]
) -> list[OutlierCamera]:
    """List the spans of frames in which a camera is contradicted, in order."""
    found = [
        OutlierCamera(name, results[first].frame, results[stop - 1].frame)
        for name, marked in zip(names, contradicted(results, settings).T, strict=False)
        for first, stop in runs(marked)
    ]
    return sorted(found, key=lambda span: (span.first, span.camera))


def contradicted(results: Sequence[FrameResult], settings: VerdictSettings) -> Bool[np.ndarray, "frame camera"]:
    """Mark cameras that agree with no other although some agree with one another.

    The median of `settings.steady` frames counts. Two agree where what they show of the body's surface is the same in
    at least `MATCHED` of it and at most `VIEW_GAP` metres apart; of two cameras none can be told to
    be the wrong one, nor one that shares nothing with any other.
    """
    cameras = max((len(result.signals.costs) for result in results if result.signals is not None), default=0)
    outlier = np.zeros((len(results), cameras))
    for index, result in enumerate(results):
        if result.signals is not None:
            outlier[index] = _without_company(result.signals)
    if cameras:
        outlier = np.stack([steadied(marks, settings.steady) for marks in outlier.T], -1)
    return (outlier > 0.5) & ((outlier <= 0.5).sum(axis=1, keepdims=True) >= 2)


def agreement(signals: FrameSignals) -> tuple[Bool[np.ndarray, "camera camera"], Bool[np.ndarray, "camera camera"]]:
    """Find which cameras share enough to be compared, and which of those agree; in both directions alike."""
    cameras = len(signals.costs)
    gaps, matched = np.full((2, cameras, cameras), np.nan)
    ahead = ~np.eye(cameras, dtype=bool)  # row by row, as `FrameSignals` lists the pairs
    gaps[ahead], matched[ahead] = signals.view_gaps, signals.matched
    known = np.isfinite(matched) & np.isfinite(matched.T)
    near = np.maximum(gaps, gaps.T) <= VIEW_GAP
    return known, known & near & (0.5 * (matched + matched.T) >= MATCHED)


def _without_company(signals: FrameSignals) -> Bool[np.ndarray, "camera"]:
    known, agree = agreement(signals)
    return np.any(agree) & np.any(known, axis=1) & ~np.any(agree, axis=1)
