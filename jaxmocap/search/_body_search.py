"""The search of a whole body: root, torso, then each limb; where it may be left out and where it is run again."""

from collections import deque
from collections.abc import Callable
from typing import Any

import jax
import numpy as np
from jaxtyping import Bool, Float, PRNGKeyArray

from jaxmocap._runtime import Clock
from jaxmocap.character import (
    Pose,
    dominant_bodies,
    group_bodies,
    initial_spread,
    outer_halves,
    retract,
    skin,
    with_limb,
)
from jaxmocap.energies import SearchEnergy
from jaxmocap.motion import MotionHistory
from jaxmocap.observation import FrameProblem, Observations

from ._evidence import Seen, look_at, mean_costs, seen_shares, unexplained
from ._gating import GroupGate, Retry
from ._group_search import Stage, group_searches, is_limb, simplified_mesh
from ._plan import SearchPlan, sigma_floor
from ._score import PoseScore

REMEMBERED = 30
"""Frames that say how much of the person usually stays uncovered."""


CLOSE = 2.0
"""Times the spread that keep a search where a limb was last seen."""


WIDE_TRUNK = 0.5
"""Share of far particles when the whole person is looked for."""


class BodySearch:
    """Sec. 4.1: every group starts from what the earlier ones found (host)."""

    def __init__(
        self, observations: Observations, energy: SearchEnergy, plan: SearchPlan, score: PoseScore, key: PRNGKeyArray
    ):
        self.character = observations.character
        self.fps = observations.capture.fps
        self.energy = energy
        self.score = score
        self.plan = plan
        self.key = key
        shares = sorted({stage.faces for stage in plan.stages} - {1.0})
        meshes = {share: simplified_mesh(self.character, observations.surface, share) for share in shares}
        whole = (("body", tuple(range(self.character.skeleton.num_dofs))),) if plan.groups == "whole" else None
        self.groups = group_searches(self.character, meshes, whole)
        self.limbs = [number for number, group in enumerate(self.groups) if is_limb(group)]
        self.spread = initial_spread(self.character)
        self.face_bodies = dominant_bodies(self.character)
        faces = np.asarray(self.character.faces)
        self.vertices = [np.unique(faces[np.asarray(group.part.moves)]) for group in self.groups]
        self.bodies = [group_bodies(self.character, group.dofs) for group in self.groups]
        self.outer_bodies = outer_halves(self.character)
        self.left: deque[float] = deque(maxlen=REMEMBERED)
        self.last_seen: list[Pose | None] = [None] * len(self.limbs)
        self.tried_for = np.zeros(len(self.limbs), int)
        self.gate = GroupGate(plan.gating, len(self.groups)) if plan.gating is not None else None

    def __call__(
        self,
        pose: Pose,
        problem: FrameProblem,
        frame: int,
        history: MotionHistory | None,
        clock: Clock,
        settle: Callable[[Pose], Pose],
        lost: bool = False,
    ) -> tuple[Pose, Float[np.ndarray, "dof"]]:
        """The pose found from this start, and the deviation of the last particles. `settle` is what follows the search,
        the refinement. When the person was `lost`, root and torso look further afield too."""
        start, deviation = pose, np.zeros(39)
        if lost and self.plan.relocalise > 0:
            with clock.stage("relocalise"):
                pose = self._relocalised(pose, problem, frame)
        wanted = self._wanted(pose, problem, history, clock)
        for number in np.flatnonzero(wanted):
            with clock.stage(f"search {self.groups[number].name}"):
                pose, found = self.group(int(number), pose, problem, history, self.key_of(frame, int(number)))
                deviation += found
        if self.plan.retry is not None:
            with clock.stage("search again"):
                pose = self._again(self.plan.retry, start, pose, problem, frame, settle)
        return pose, deviation

    def key_of(self, frame: int, number: int) -> PRNGKeyArray:
        """The key of one of a frame's searches."""
        return jax.random.fold_in(jax.random.fold_in(self.key, frame), number)

    def group(
        self,
        number: int,
        pose: Pose,
        problem: FrameProblem,
        history: MotionHistory | None,
        key: PRNGKeyArray,
        wide: float | None = None,
        within: float = np.inf,
    ) -> tuple[Pose, Float[np.ndarray, "dof"]]:
        """Search one group; `wide` is the share of far particles, by default the plan's for a limb and else none, and
        `within` how many times the spread they may go."""
        plan, group = self.plan, self.groups[number]
        limb = is_limb(group)
        wide = (plan.wide if limb else 0.0) if wide is None else wide
        pace = history.pace(self.fps) if history is not None and plan.wide == 0 else 1.0
        stages = tuple(Stage(self.energy, *effort) for effort in plan.stages)
        share = 1.0 if limb else plan.trunk
        sampler = plan.sampler(len(group.dofs), sigma_floor(group.dofs), share)
        spread = self.spread * plan.spread * pace * share
        found = group(stages, sampler, self.character, pose, problem, spread, key, wide, within, plan.prior)
        return retract(self.character.skeleton, pose, found.increment), np.asarray(found.deviation)

    def learn(self, seen: Seen, pose: Pose) -> None:
        """Remember how well a frame's answer explains each group, and the limbs it shows."""
        if self.plan.retry is not None:
            shown = self._shares(seen) >= self.plan.retry.hidden
            self.last_seen = [pose if s else last for s, last in zip(shown, self.last_seen, strict=True)]
        if self.gate is not None:
            self.gate.learn(mean_costs(self.bodies, self.face_bodies, seen.ids, seen.costs))

    def state(self) -> dict[str, Any]:
        """What is remembered between frames, the sizes of the compiled searches among it."""
        gate = self.gate
        return {
            "left": self.left,
            "last_seen": self.last_seen,
            "tried_for": self.tried_for,
            "sizes": [group.sizes for group in self.groups],
            "gate": None if gate is None else (gate.known, gate.skipped),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Take over what `state` said."""
        self.left, self.last_seen, self.tried_for = state["left"], state["last_seen"], state["tried_for"]
        for group, sizes in zip(self.groups, state["sizes"], strict=True):
            vars(group.sizes).update(vars(sizes))  # left and right share theirs
        if self.gate is not None:
            self.gate.known, self.gate.skipped = state["gate"]

    def _relocalised(self, pose: Pose, problem: FrameProblem, frame: int) -> Pose:
        """The best of some searches for root and torso that look further afield."""
        trunk = [number for number, group in enumerate(self.groups) if not is_limb(group)]
        found = [pose]
        for attempt in range(self.plan.relocalise):
            answer = pose
            for number in trunk:
                key = self.key_of(frame, 400 + 10 * attempt + number)
                answer, _ = self.group(number, answer, problem, None, key, WIDE_TRUNK)
            found.append(answer)
        totals, _ = self.score(problem, found)
        return found[int(np.argmin(totals))]

    def _wanted(
        self, pose: Pose, problem: FrameProblem, history: MotionHistory | None, clock: Clock
    ) -> Bool[np.ndarray, "group"]:
        """The groups to search from this start."""
        if self.gate is None or history is None:
            return np.ones(len(self.groups), bool)
        with clock.stage("gating"):
            moved = np.asarray(skin(self.character, pose) - skin(self.character, history.pose))
            distance = np.linalg.norm(moved, axis=1) * self.fps
            speeds = np.array([np.percentile(distance[vertices], 90) for vertices in self.vertices])
            seen = look_at(self.character, pose, problem)
            return self.gate.search(speeds, mean_costs(self.bodies, self.face_bodies, seen.ids, seen.costs))

    def _again(
        self,
        retry: Retry,
        start: Pose,
        pose: Pose,
        problem: FrameProblem,
        frame: int,
        settle: Callable[[Pose], Pose],
    ) -> Pose:
        """Limbs that seem lost, searched in turn from where the frame's search began and from where it ended; hidden
        ones also from where they were last seen. Those of the frame before have a part of these searches."""
        seen = look_at(self.character, pose, problem)
        doubtful = mean_costs(self.outer_bodies, self.face_bodies, seen.ids, seen.costs) > retry.foreign
        hidden = self._shares(seen) < retry.hidden
        left, usual = unexplained(seen.ids, problem), np.median(self.left) if self.left else 0.0
        self.left.append(left)
        doubtful |= hidden | (left > max(retry.uncovered, retry.unusual * usual))
        for limb in np.flatnonzero(doubtful & (retry.tries > 0)):
            number = self.limbs[limb]
            dofs = self.groups[number].dofs
            starts = [(with_limb(pose, start, dofs), pose)[i % 2] for i in range(retry.tries)]
            within = [np.inf] * retry.tries
            if hidden[limb] and (last := self.last_seen[limb]) is not None:
                starts += [with_limb(pose, last, dofs)] * retry.tries
                within += [(CLOSE, np.inf)[i % 2] for i in range(retry.tries)]
            keys = jax.random.split(self.key_of(frame, 100 + number), len(starts))
            searches = list(zip(starts, keys, within, strict=True))
            if self.tried_for[limb] > 0:
                searches = searches[self.tried_for[limb] % retry.turns :: retry.turns] or searches[:1]
            found = [self.group(number, begin, problem, None, key, within=reach)[0] for begin, key, reach in searches]
            totals, _ = self.score(problem, [pose, *found])
            best = int(np.argmin(totals[1:]))
            if totals[1 + best] < totals[0] - retry.margin:
                pose = found[best]
            elif hidden[limb]:
                pose = self._shown(retry, int(limb), [pose, *found], totals, problem, settle)
        self.tried_for = np.where(doubtful, self.tried_for + 1, 0)
        return pose

    def _shown(
        self,
        retry: Retry,
        limb: int,
        poses: list[Pose],
        totals: Float[np.ndarray, "pose"],
        problem: FrameProblem,
        settle: Callable[[Pose], Pose],
    ) -> Pose:
        """The best pose that shows a limb, where it explains as much as the first, which hides it, or does so once both
        have settled."""
        shown = np.array([self.shares(pose, problem)[limb] for pose in poses]) >= retry.hidden
        best = int(np.argmin(np.where(shown, totals, np.inf)))
        if not shown[best] or totals[best] > totals[0] + retry.near:
            return poses[0]
        if totals[best] <= totals[0] + retry.slack:
            return poses[best]
        settled, _ = self.score(problem, [settle(poses[0]), settle(poses[best])])
        return poses[best] if settled[1] <= settled[0] + retry.slack else poses[0]

    def shares(self, pose: Pose, problem: FrameProblem) -> Float[np.ndarray, "limb"]:
        """How much of each limb's outer half a pose shows."""
        return self._shares(look_at(self.character, pose, problem))

    def _shares(self, seen: Seen) -> Float[np.ndarray, "limb"]:
        return seen_shares(self.outer_bodies, self.character, self.face_bodies, seen.over)
