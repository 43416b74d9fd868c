"""Where the search may be left out, and where it must be run again, group by group."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxmocap._results import InputError
from jaxmocap.character import Character


@dataclass(frozen=True)
class Calm:
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


@dataclass(frozen=True)
class Hindsight:
    """A limb whose outer half looks foreign (mean cost of Eq. 6 above `foreign`), and less so by `better` in a later
    frame, is searched again from there, backwards through at most `longest` frames; the answer counts where it lowers
    the energy by `margin`. A limb that is more than `stray` metres from halfway between the frames before and after,
    an acceleration above `jolt` metres per second squared, is searched again from halfway; the answer counts where it
    strays half as far, does not hide the limb (less than `hidden` of its outer half seen in any view, where more was),
    and raises the energy by less than `slack`. The paper only looks forwards."""

    foreign: float = 0.45
    better: float = 0.15
    longest: int = 6
    margin: float = 0.002
    stray: float = 0.15
    jolt: float = 200.0
    hidden: float = 0.5
    slack: float = 0.004


def group_bodies(character: Character, dofs: tuple[int, ...], outer: bool = False) -> Bool[np.ndarray, "body"]:
    """The bodies a group moves; with `outer` those beyond its elbow or knee."""
    skeleton = character.skeleton
    if min(dofs) < 6:
        return np.ones(len(skeleton.body_names), bool)
    hinges = [d for d in dofs if outer and any(part in skeleton.dof_names[d] for part in ("elbow", "knee"))]
    return np.asarray(skeleton.moved_by()[np.array(hinges or dofs) - 6].any(0))


def outer_halves(character: Character) -> list[Bool[np.ndarray, "body"]]:
    """The bodies beyond the elbow or knee of each limb, in the order of the skeleton's groups."""
    limbs = [dofs for name, dofs in character.skeleton.groups if name.endswith(("arm", "leg"))]
    return [group_bodies(character, dofs, outer=True) for dofs in limbs]


def mean_costs(
    groups: list[Bool[np.ndarray, "body"]],
    face_bodies: Int[np.ndarray, "face"],
    ids: Int[np.ndarray, "camera height width"],
    costs: Float[np.ndarray, "camera height width"],
) -> Float[np.ndarray, "group"]:
    """Mean cost over the pixels of each group of bodies, all views together; NaN where none is seen."""
    covered = ids >= 0
    body = face_bodies[ids[covered]]
    bodies = len(groups[0])
    count = np.bincount(body, minlength=bodies)
    total = np.bincount(body, weights=costs[covered], minlength=bodies)
    seen = np.array([count[group].sum() for group in groups])
    return np.array([total[group].sum() for group in groups]) / np.where(seen > 0, seen, np.nan)


def seen_shares(
    groups: list[Bool[np.ndarray, "body"]],
    character: Character,
    face_bodies: Int[np.ndarray, "face"],
    over: Int[np.ndarray, "camera vertex"],
) -> Float[np.ndarray, "group"]:
    """Share of each group's vertices that project to pixels of the group, in the view where it is largest: 1 for a limb
    in front of everything, though half its vertices face away; 0 for one behind the body."""
    own = np.asarray(character.weights).argmax(1)
    below = np.where(over >= 0, face_bodies[over], -1)
    shares = [np.where(below >= 0, group[below], False)[:, group[own]].mean(1).max() for group in groups]
    return np.array(shares)


class Restraint:
    """Remembers how well each group was explained and how often it was left out (host)."""

    def __init__(self, settings: Calm, groups: int):
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
