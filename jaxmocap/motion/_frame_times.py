"""When frames were taken: how many frames long an interval is, and what a container rounded away."""

import numpy as np
from jaxtyping import Float

TICKS = (1 / 600, 1 / 1000)
"""Seconds: the coarsest units in which containers count time, QuickTime's and Matroska's. Others do not matter."""

QUARTER = 0.25
"""Of an interval: where frames are so near to each other that a tick is more, this is what rounding may do."""

SHORTEST_STEP = 0.5
"""Frames that an interval counts at least: over less, a pose's error would pass for speed."""

EVEN_RUN = 5
"""Frames in a row, whole intervals apart, that are no chance."""

EXACT = 1e-3
"""Of an interval or a tick: times that are so near to a grid lie on it."""

STRIDE = 0.25
"""Seconds in which no foot is lifted and stands again: between frames farther apart nobody knows what it did."""


def usual_interval(timestamps: Float[np.ndarray, " frame"]) -> float:
    """Measure the seconds from one frame to the next where none is missing; 0 for a single frame.

    It is what the intervals near the short ones and near their multiples have in common: one alone has the container's
    rounding, where many frames are missing the median is of several, and a tenth may be shorter by mistake.
    """
    apart = np.diff(np.asarray(timestamps, np.float64))
    if not len(apart):
        return 0.0
    least = max(np.percentile(apart, 10, method="lower"), np.median(apart) / 4)
    short = apart[apart >= least].min()
    interval = apart[np.abs(apart - short) < 0.75 * short].mean()
    whole = np.round(apart / interval)
    near = (whole > 0) & (np.abs(apart / interval - whole) <= QUARTER)
    return float(apart[near].sum() / whole[near].sum()) if near.any() else float(interval)


def frames_apart(seconds: Float[np.ndarray, "*interval"], interval: float) -> Float[np.ndarray, "*interval"]:
    """Tell how many usual intervals long these are, forwards or backwards.

    What rounding to a container's ticks explains is a whole number; other intervals, of a variable frame rate, are what
    they are.
    """
    ratio = np.abs(seconds) / interval
    whole = np.maximum(np.round(ratio), 1.0)
    return np.where(np.abs(ratio - whole) <= min(TICKS[0] / interval, QUARTER), whole, ratio)


def evened(timestamps: Float[np.ndarray, " frame"]) -> Float[np.ndarray, " frame"]:
    """Take out what a container rounded, seconds: frames that lie on an even grid but for its ticks, with holes or
    without, get the times of the grid. All others, and times that are even as they are, stay to the bit."""
    times = np.asarray(timestamps, np.float64)
    interval, tick = usual_interval(times), _tick(times)
    if interval <= 0 or tick is None:
        return times
    steps = frames_apart(np.diff(times), interval)
    breaks = np.flatnonzero(steps != np.round(steps)) + 1
    runs = zip(np.split(times, breaks), np.split(np.insert(steps, 0, 0.0), breaks), strict=True)
    return np.concatenate([_on_grid(run, np.cumsum([0.0, *apart[1:]]), tick) for run, apart in runs])


def _tick(times: Float[np.ndarray, " frame"]) -> float | None:
    """Find the coarse unit in which these times were counted, if there is one."""
    for tick in TICKS:
        count = (times - times[0]) / tick
        if np.abs(count - np.round(count)).max() < EXACT:
            return tick
    return None


def _on_grid(
    times: Float[np.ndarray, " frame"], numbers: Float[np.ndarray, " frame"], tick: float
) -> Float[np.ndarray, " frame"]:
    if len(times) < EVEN_RUN:
        return times
    slope, start = np.polyfit(numbers, times, 1)
    grid = start + slope * numbers
    return grid if EXACT * slope < np.abs(times - grid).max() <= min(tick, QUARTER * slope) else times
