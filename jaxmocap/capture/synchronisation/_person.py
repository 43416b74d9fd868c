"""By a person seen in both videos: how high hands, feet and head are at a time looks alike from every side."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

_LEAST_SHARED = 0.5  # of the shorter video
_FEWEST = 20  # pictures of both
_NEAR = 0.15  # seconds: offsets as near as this are the same answer
SURE_LIKENESS, SURE_MARGIN = 0.8, 0.03


@dataclass(frozen=True)
class PersonOffset:
    """When a video began by a person's motion in two.

    Attributes:
        seconds: added to the second video's own time to give the first one's.
        likeness: correlation of the heights at that offset, 1 for the same motion.
        elsewhere: the largest correlation at another offset.
    """

    seconds: float
    likeness: float
    elsewhere: float

    @property
    def sure(self) -> bool:
        """Whether this is more than chance."""
        return self.likeness >= SURE_LIKENESS and self.likeness - self.elsewhere >= SURE_MARGIN


@dataclass(frozen=True)
class PersonHeights:
    """How high points of a person are, from the hips, in lengths of the trunk; NaN where they are not seen.

    Attributes:
        seconds: of the video's own time, rising.
        heights: per picture and point.
    """

    seconds: Float[np.ndarray, "frame"]
    heights: Float[np.ndarray, "frame point"]

    def at(self, seconds: Float[np.ndarray, "time"]) -> Float[np.ndarray, "time point"]:
        """Interpolate between pictures; NaN outside them."""
        columns = [np.interp(seconds, self.seconds, column, np.nan, np.nan) for column in self.heights.T]
        return np.stack(columns, axis=1)


def offset_by_person(first: PersonHeights, second: PersonHeights) -> PersonOffset | None:
    """Find the offset at which the heights of two videos are most alike; None where they share too few pictures.

    Upright cameras see heights alike from all sides. Offsets are tried by half pictures and the best is refined by a
    parabola. Half of the shorter video has to be shared.
    """
    if min(len(first.seconds), len(second.seconds)) < _FEWEST:
        return None
    step = 0.5 * float(np.median(np.diff(first.seconds)))
    shared = _LEAST_SHARED * min(np.ptp(first.seconds), np.ptp(second.seconds))
    earliest = first.seconds[0] - second.seconds[-1] + shared
    latest = first.seconds[-1] - second.seconds[0] - shared
    offsets = np.arange(np.ceil(earliest / step), np.floor(latest / step) + 1) * step
    scores = np.array([_likeness(first.heights, second.at(first.seconds - offset)) for offset in offsets])
    if not np.isfinite(scores).any():
        return None
    best = int(np.nanargmax(scores))
    away = scores[np.abs(offsets - offsets[best]) > _NEAR]
    elsewhere = float(np.nanmax(away)) if np.isfinite(away).any() else 0.0
    return PersonOffset(float(offsets[best] + step * _peak(scores, best)), float(scores[best]), elsewhere)


def _likeness(first: Float[np.ndarray, "frame point"], second: Float[np.ndarray, "frame point"]) -> float:
    """Correlate all points together, each about its mean; NaN where fewer than `_FEWEST` pictures show them."""
    seen = np.isfinite(first) & np.isfinite(second)
    if seen.any(1).sum() < _FEWEST:
        return np.nan
    count = np.maximum(seen.sum(0), 1)
    a, b = (np.where(seen, values, 0.0) for values in (first, second))
    a, b = (np.where(seen, values - values.sum(0) / count, 0.0) for values in (a, b))
    scale = np.sqrt((a**2).sum() * (b**2).sum())
    return float((a * b).sum() / scale) if scale > 0 else np.nan


def _peak(scores: Float[np.ndarray, "offset"], best: int) -> float:
    """Where a parabola through the best score and its neighbours is highest, in steps from the best."""
    if not 0 < best < len(scores) - 1:
        return 0.0
    before, at, after = scores[best - 1 : best + 2]
    bend = before - 2 * at + after
    return float(np.clip(0.5 * (before - after) / bend, -0.5, 0.5)) if np.isfinite(bend) and bend < 0 else 0.0
