"""The part of the footage in which all cameras can be placed, where one cannot in the rest: laid down, say, or cut."""

from collections.abc import Collection, Mapping

import numpy as np
from jaxtyping import Bool

from ._footage import Footage

_WORTHWHILE = 10  # frames


def longest_run(mask: Bool[np.ndarray, " frame"]) -> tuple[int, int]:
    """Find the longest run of true values, (first, behind the last); (0, 0) where none is."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(int), [0]]))).reshape(-1, 2)
    return max(((int(start), int(stop)) for start, stop in edges), key=lambda run: run[1] - run[0], default=(0, 0))


def advise_part(usable: Bool[np.ndarray, " frame"], first: int) -> str:
    """Say which frames to take alone, the longest run of usable ones, counted from the `first` shared frame.

    Says "" where all are usable or all runs are short.
    """
    start, stop = longest_run(usable)
    if not _WORTHWHILE <= stop - start < len(usable):
        return ""
    start, stop = start + first, stop + first
    return f"take shared frames {start} to {stop - 1} alone, in which all can be placed, with --frames {start}:{stop}"


def advise_keys(footage: Footage, usable: Mapping[int, Collection[int]]) -> str:
    """Say which shared frames to take alone, those between usable key frames of all cameras, as `advise_part` does.

    `usable` are key frames by camera; those of a camera that is left out all are.
    """
    good = np.ones(len(footage.videos[0].wanted), bool)
    for camera, frames in usable.items():
        keys, wanted = np.array(footage.key_frames(camera)), np.array(footage.videos[camera].wanted, int)
        known = np.isin(keys, list(frames))
        after = np.searchsorted(keys, wanted)
        good &= known[after] & known[after - (keys[after] > wanted)]
    return advise_part(good, footage.first_wanted)
