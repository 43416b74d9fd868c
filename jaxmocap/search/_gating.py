"""Which groups of degrees of freedom a frame searches, and which it searches again."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxmocap._results import InputError
from jaxmocap.character import Pose

SPEED = 3.0
"""Metres per second that the 90th percentile of a group's vertices may move from the last frame to the start, or the
group is searched."""


@dataclass(frozen=True)
class Gating:
    """Leave out a group whose flow start explains its pixels as well as the frame before did and does not jump. Not in
    the paper, which searches everything and names this as future work.

    Attributes:
        slack: how much the mean cost of Eq. 6 over its pixels may have grown.
        longest: frames in a row after which a group is searched all the same.
    """

    slack: float = 0.01
    longest: int = 3


@dataclass(frozen=True)
class Retry:
    """Search a limb again that seems lost. Not in the paper.

    Of all answers the best is taken when it is clearly better. Behind the body a limb costs nothing, and one that is
    seen costs little only in its exact place; so a hidden limb also gives way to an answer that is seen and hardly
    worse, at once or once both are refined.

    Attributes:
        hidden: a limb is hidden when less than this share of its distal half is seen in any view.
        foreign: it is searched again when the mean cost of Eq. 6 over its distal half is above this.
        uncovered: all limbs are when more than this share of the person looks foreign and is covered by nothing.
        unusual: and this many times as much as in the median of the last frames: clothes wider than the mesh always
            are.
        tries: answers per limb, twice as many for a hidden one.
        turns: where a limb is searched again in frame after frame, one of so many searches is made in each.
    """

    hidden: float = 0.5
    foreign: float = 0.48
    uncovered: float = 0.015
    unusual: float = 1.5
    tries: int = 3
    turns: int = 3

    def __post_init__(self) -> None:
        if self.turns < 1:
            raise InputError(
                f"limbs that are searched again take turns of {self.turns} frames; set `turns` to 1 or more."
            )


class SearchMemory(NamedTuple):
    """What a search hands from one frame to the next.

    Attributes:
        explained: mean cost of each group's pixels in the last answer, -inf where it is not known.
        skipped: how many frames in a row each group was not searched.
        uncovered: what share of the person stayed uncovered in the last frames, oldest first.
        last_seen: the last pose that shows each limb, if any did.
        searched_again: how many frames in a row each limb was searched again.
    """

    explained: Float[np.ndarray, "group"]
    skipped: Int[np.ndarray, "group"]
    uncovered: tuple[float, ...]
    last_seen: tuple[Pose | None, ...]
    searched_again: Int[np.ndarray, "limb"]

    @staticmethod
    def start(groups: int, limbs: int) -> "SearchMemory":
        """Make the memory in which nothing is known, before the first frame."""
        unknown = np.full(groups, -np.inf)
        return SearchMemory(unknown, np.zeros(groups, int), (), (None,) * limbs, np.zeros(limbs, int))


def gated(
    settings: Gating, memory: SearchMemory, speeds: Float[np.ndarray, "group"], costs: Float[np.ndarray, "group"]
) -> tuple[Bool[np.ndarray, "group"], SearchMemory]:
    """Choose which groups to search, from how fast each starts and what its start costs.

    Returns with them the memory after that.
    """
    still = (speeds < SPEED) & (costs <= memory.explained + settings.slack)
    needed = ~still | (memory.skipped >= settings.longest)
    return needed, memory._replace(skipped=np.where(needed, 0, memory.skipped + 1))
