"""The search of a whole body (sec. 4.1): root, torso, then each limb, each from what the earlier ones found."""

from typing import Any

import jax
import numpy as np
from jaxtyping import Bool, Float, PRNGKeyArray

from jaxmocap._runtime import Clock
from jaxmocap.character import Pose, retract, skin
from jaxmocap.energies import SearchEnergy, body_part
from jaxmocap.motion import MotionHistory
from jaxmocap.observation import Frame, FrameProblem, Observations
from jaxmocap.samplers import AbstractSampler

from ._drawn_meshes import simplified_mesh
from ._evidence import DrawnPose, Evidence, PoseScore
from ._gating import SearchMemory, gated
from ._group_search import Reach, group_searches
from ._plan import SearchPlan

WIDE_TRUNK = 0.5
"""Share of far particles when the whole person is looked for."""


class BodySearch:
    """Searches group after group (host). What one frame hands to the next is a `SearchMemory`; the sizes of compiled
    searches, which only grow, stay here."""

    def __init__(
        self,
        observations: Observations,
        energy: SearchEnergy,
        plan: SearchPlan,
        sampler: AbstractSampler,
        score: PoseScore,
        evidence: Evidence,
        key: PRNGKeyArray,
    ):
        self.character = score.character
        self.fps = observations.capture.fps
        self.plan = plan
        self.sampler = sampler
        self.score = score
        self.key = key
        skeleton = self.character.skeleton
        mesh = None if plan.faces == 1 else simplified_mesh(observations.character, observations.surface, plan.faces)
        whole = (("body", tuple(range(skeleton.num_dofs))),) if plan.groups == "whole" else None
        self.groups = group_searches(self.character, energy, plan.step, mesh, whole)
        self.limbs = [number for number, group in enumerate(self.groups) if group.name in skeleton.limbs]
        everything = [np.ones(len(skeleton.body_names), bool)]
        self.evidence = evidence
        self.bodies = everything if whole else evidence.groups
        faces = np.asarray(self.character.faces)
        parts = [body_part(self.character, group.dofs) for group in self.groups]
        self.vertices = [np.unique(faces[np.asarray(part.moves)]) for part in parts]

    def start(self) -> SearchMemory:
        """Make the memory before the first frame."""
        return SearchMemory.start(len(self.groups), len(self.limbs))

    def __call__(
        self,
        frame: Frame,
        pose: Pose,
        history: MotionHistory | None,
        memory: SearchMemory,
        clock: Clock,
        lost: bool = False,
    ) -> tuple[Pose, Float[np.ndarray, "dof"], SearchMemory]:
        """Search from a start: the pose found, the deviation of the last particles, and the memory after that.

        When the person was `lost`, root and torso look further afield first.
        """
        deviation = np.zeros(self.character.skeleton.num_dofs)
        if lost and self.plan.relocalise > 0:
            with clock.stage("relocalise"):
                pose = self._relocalised(pose, frame)
        wanted, memory = self._wanted(frame, pose, history, memory, clock)
        for number in np.flatnonzero(wanted):
            with clock.stage(f"search {self.groups[number].name}"):
                key = self.key_of(frame.number, int(number))
                pose, found = self.group(int(number), pose, frame.problem, history, key)
                deviation += found
        return pose, deviation, memory

    def key_of(self, frame: int, number: int) -> PRNGKeyArray:
        """Derive the key of one of a frame's searches."""
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
        limb = number in self.limbs
        wide = (plan.wide if limb else 0.0) if wide is None else wide
        pace = history.pace(self.fps) if history is not None and plan.wide == 0 else 1.0
        share = 1.0 if limb else plan.trunk
        sampler = plan.sized(self.sampler, group.dofs, share, len(group.part.dofs))
        spread = self.character.skeleton.initial_spread * plan.spread * pace * share
        found = group(sampler, pose, problem, spread, key, Reach(wide, within, plan.prior))
        return retract(self.character.skeleton, pose, found.increment), np.asarray(found.deviation)

    def remember(self, memory: SearchMemory, drawn: DrawnPose) -> SearchMemory:
        """Remember a frame's answer: how well it explains each group, and the limbs it shows."""
        if self.plan.retry is not None:
            shown = self.evidence.limb_shares(drawn) >= self.plan.retry.hidden
            seen = zip(shown, memory.last_seen, strict=True)
            memory = memory._replace(last_seen=tuple(drawn.pose if now else last for now, last in seen))
        if self.plan.gating is not None:
            costs = self.evidence.mean_costs(drawn, self.bodies)
            memory = memory._replace(explained=np.where(np.isnan(costs), -np.inf, costs))
        return memory

    def sizes(self) -> list[Any]:
        """Return the static sizes of the compiled searches: with them another process goes on to the same bits."""
        return [group.sizes for group in self.groups]

    def restore_sizes(self, sizes: list[Any]) -> None:
        """Take over what `sizes` said."""
        for group, size in zip(self.groups, sizes, strict=True):
            vars(group.sizes).update(vars(size))  # some share theirs

    def _relocalised(self, pose: Pose, frame: Frame) -> Pose:
        """Choose the best of some searches for root and torso that look further afield."""
        trunk = [number for number in range(len(self.groups)) if number not in self.limbs]
        found = [pose]
        for attempt in range(self.plan.relocalise):
            answer = pose
            for number in trunk:
                key = self.key_of(frame.number, 400 + 10 * attempt + number)
                answer, _ = self.group(number, answer, frame.problem, None, key, WIDE_TRUNK)
            found.append(answer)
        totals, _ = self.score(frame.problem, found)
        return found[int(np.argmin(totals))]

    def _wanted(
        self, frame: Frame, pose: Pose, history: MotionHistory | None, memory: SearchMemory, clock: Clock
    ) -> tuple[Bool[np.ndarray, "group"], SearchMemory]:
        """Choose the groups to search from this start; return them with the memory after that."""
        if self.plan.gating is None or history is None:
            return np.ones(len(self.groups), bool), memory
        with clock.stage("gating"):
            moved = np.asarray(skin(self.character, pose) - skin(self.character, history.pose))
            distance = np.linalg.norm(moved, axis=1) * self.fps
            speeds = np.array([np.percentile(distance[vertices], 90) for vertices in self.vertices])
            costs = self.evidence.mean_costs(self.evidence.draw(pose, frame.problem), self.bodies)
            return gated(self.plan.gating, memory, speeds, costs)
