"""Which groups of degrees of freedom a frame searches, and which it searches again."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from jaxmocap._results import InputError


@dataclass(frozen=True)
class Gating:
    """A group is not searched where its flow start explains its pixels as well as the frame before and does not jump.

    `speed` (metres per second) bounds the 90th percentile of the group's vertices between the last frame and the flow
    start; `slack` how much the mean cost of Eq. 6 over its pixels may have grown; after `longest` frames in a row a
    group is searched all the same. The paper searches everything and names this as future work.
    """

    speed: float = 3.0
    slack: float = 0.01
    longest: int = 3


@dataclass(frozen=True)
class Retry:
    """A limb is searched again when less than `hidden` of its outer half is seen in any view, when the mean cost of
    Eq. 6 over its outer half is above `foreign`, or, all limbs, when more than `uncovered` of the person's pixels look
    foreign and are covered by nothing, and `unusual` times as many as in the median of the last frames: clothes that
    are wider than the mesh always stay uncovered. Of `tries` answers, twice as many for a hidden limb, the best is
    taken when it lowers the energy by `margin`. Behind the body a limb costs nothing, and one that is seen costs little
    only in its exact place: a hidden limb also gives way to an answer that is seen and raises the energy by less
    than `slack`, or by less than `near` and less than `slack` once both are refined. Where a limb is searched again in
    one frame after another, the searches take turns: one of every `turns`. The paper does not."""

    hidden: float = 0.5
    foreign: float = 0.48
    uncovered: float = 0.015
    unusual: float = 1.5
    tries: int = 3
    margin: float = 0.005
    slack: float = 0.001
    near: float = 0.01
    turns: int = 3

    def __post_init__(self) -> None:
        if self.turns < 1:
            raise InputError(
                f"limbs that are searched again take turns of {self.turns} frames; set `turns` to 1 or more."
            )


class GroupGate:
    """Remembers how well each group was explained and how often it was left out (host)."""

    def __init__(self, settings: Gating, groups: int):
        self.settings = settings
        self.known = np.full(groups, -np.inf)
        self.skipped = np.zeros(groups, int)

    def search(
        self, speeds: Float[np.ndarray, "group"], costs: Float[np.ndarray, "group"]
    ) -> Bool[np.ndarray, "group"]:
        """Which groups to search; `costs` are those of the start."""
        calm = (speeds < self.settings.speed) & (costs <= self.known + self.settings.slack)
        needed = ~calm | (self.skipped >= self.settings.longest)
        self.skipped = np.where(needed, 0, self.skipped + 1)
        return needed

    def learn(self, costs: Float[np.ndarray, "group"]) -> None:
        """Costs of the frame's answer."""
        self.known = np.where(np.isnan(costs), -np.inf, costs)
