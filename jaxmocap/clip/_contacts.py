"""Feet that stand: found in a motion by the height and the speed of heels and toes, never assumed."""

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxmocap.character import Skeleton
from jaxmocap.motion import STRIDE, Contact

FOOT_POINTS = ("heel", "toe")
"""Landmarks of a foot that may stand, after `l_` and `r_`."""


GROUND = 5.0
"""Percentile of a point's heights that is the ground: a frame that was lost must not lower it."""

LEVEL = 0.15
"""Metres: a heel and a toe that stand differ by less in height."""

HEIGHT = 0.025
"""Metres over the ground at which a contact begins (Zhang et al. 2018, as in `foot_skate`)."""

SPEED = 0.1
"""Metres per second below which a contact begins: what slides on slowly does not stand."""

RELEASE = 2.0
"""Factor on height and speed at which a contact ends."""

SHORTEST = 0.06
"""Seconds that a contact lasts at least."""


def find_contacts(
    places: Float[np.ndarray, "frame landmark 3"],
    timestamps: Float[np.ndarray, " frame"],
    skeleton: Skeleton,
    up: Float[np.ndarray, "3"],
) -> list[Contact]:
    """Find where heels and toes stand, with hysteresis: a contact begins low and slow and ends higher or faster.

    The ground is level and lies where a point is at its lowest, unless the lowest of the whole body is `LEVEL` lower: a
    foot that is held up, or those of a person who stands on the hands, never come down. No contact goes on over a gap
    in which a foot may have stepped. `up` is a unit vector.
    """
    found = []
    apart = np.diff(timestamps)
    gaps = np.flatnonzero(apart > STRIDE) + 1
    lowest = np.percentile(places.astype(np.float64) @ up, GROUND, axis=0).min(initial=np.inf)
    for name in skeleton.landmark_names:
        if name.partition("_")[2] not in FOOT_POINTS or len(places) < 2:
            continue
        path = places[:, skeleton.landmark_names.index(name)].astype(np.float64)
        height = path @ up
        if np.percentile(height, GROUND) > lowest + LEVEL:
            continue
        height = height - np.percentile(height, GROUND)
        pace = np.where(apart > STRIDE, np.inf, np.linalg.norm(np.diff(path, axis=0), axis=1) / apart)
        speed = np.minimum(np.append(pace, np.inf), np.insert(pace, 0, np.inf))  # a foot that lands stands from here on
        begins = (height < HEIGHT) & (speed < SPEED)
        holds = (height < RELEASE * HEIGHT) & (speed < RELEASE * SPEED)
        found += [
            Contact(name, first, last)
            for first, last in _spans(holds, gaps)
            if begins[first : last + 1].any() and timestamps[last] - timestamps[first] >= SHORTEST
        ]
    return found


def _spans(flags: Bool[np.ndarray, " frame"], gaps: Int[np.ndarray, " gap"]) -> list[tuple[int, int]]:
    """List first and last positions of the runs of true flags; before each position in `gaps` one ends."""
    apart = np.insert(flags.astype(np.int8), gaps, 0)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], apart, [0]])))
    position = np.insert(np.arange(len(flags)), gaps, -1)
    return [(int(position[first]), int(position[stop - 1])) for first, stop in edges.reshape(-1, 2)]
