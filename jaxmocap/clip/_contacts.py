"""Feet that stand: found in a motion by the height and the speed of heels and toes, never assumed."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from jaxmocap.character import Skeleton

FOOT_POINTS = ("heel", "toe")
"""Landmarks of a foot that may stand, after `l_` and `r_`."""


class ContactSettings(NamedTuple):
    """Say when a point of a foot stands; not in the paper.

    Attributes:
        ground: percentile of a point's heights that is the ground: a frame that was lost must not lower it; 5.
        height: metres over the ground at which a contact begins; 0.025 (Zhang et al. 2018, as in `foot_skate`).
        speed: metres per second below which a contact begins; 0.1, for what slides on slowly does not stand.
        release: factor on both at which it ends; 2.
        shortest: seconds that a contact lasts at least; 0.06.
        slip: metres that a standing point may creep in a second, standard deviation; 0.005.
    """

    ground: float = 5.0
    height: float = 0.025
    speed: float = 0.1
    release: float = 2.0
    shortest: float = 0.06
    slip: float = 0.005


class Contact(NamedTuple):
    """Say that a landmark stands from position `first` to `last` of a clip."""

    landmark: str
    first: int
    last: int


def find_contacts(
    places: Float[np.ndarray, "frame landmark 3"],
    timestamps: Float[np.ndarray, " frame"],
    skeleton: Skeleton,
    up: Float[np.ndarray, "3"],
    settings: ContactSettings | None = None,
) -> list[Contact]:
    """Find where heels and toes stand, with hysteresis: a contact begins low and slow and ends higher or faster.

    The ground is level and lies where a point is at its lowest; `up` is a unit vector. A person who hangs, or stands on
    the hands, has feet that are neither low nor still for long, and no contact.
    """
    settings = ContactSettings() if settings is None else settings
    found = []
    for name in skeleton.landmark_names:
        if name.partition("_")[2] not in FOOT_POINTS or len(places) < 2:
            continue
        path = places[:, skeleton.landmark_names.index(name)].astype(np.float64)
        height = path @ up
        height = height - np.percentile(height, settings.ground)
        pace = np.linalg.norm(np.diff(path, axis=0), axis=1) / np.diff(timestamps)
        speed = np.minimum(np.append(pace, np.inf), np.insert(pace, 0, np.inf))  # a foot that lands stands from here on
        begins = (height < settings.height) & (speed < settings.speed)
        holds = (height < settings.release * settings.height) & (speed < settings.release * settings.speed)
        found += [
            Contact(name, first, last)
            for first, last in _spans(holds)
            if begins[first : last + 1].any() and timestamps[last] - timestamps[first] >= settings.shortest
        ]
    return found


def _spans(flags: Bool[np.ndarray, " frame"]) -> list[tuple[int, int]]:
    """List first and last positions of the runs of true flags."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(np.int8), [0]])))
    return [(int(first), int(stop) - 1) for first, stop in edges.reshape(-1, 2)]
