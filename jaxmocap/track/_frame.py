"""One frame: start from flow, search group by group, refine. Sec. 4 of the paper from top to bottom."""

from collections import deque
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, PRNGKeyArray

from jaxmocap._runtime import Clock
from jaxmocap.character import Pose, clamp, difference, dominant_bodies, nearest_equivalent, outer_halves, retract, skin
from jaxmocap.motion import MotionHistory, after
from jaxmocap.observation import (
    FrameImages,
    FrameProblem,
    LightMeter,
    Observations,
    Rectangle,
    build_problem,
    draw,
    frame_rectangle,
    lit_apart,
)
from jaxmocap.refinement import (
    DetectionPlan,
    Refinement,
    Rows,
    descend,
    detection_rays,
    free_prior,
    picture_source,
    surface_flow,
)
from jaxmocap.refiners import Shooting
from jaxmocap.search import BodySearch, PoseScore, Seen, look_at, mean_costs, polish, seen_shares, unexplained
from jaxmocap.verdict import FrameResult, between, frame_signals, judge, passed_over

from ._backward_search import Tracked, search_backwards
from ._tracker import Tracker

FLOW_ROBUST = (0.08, 0.03)
"""Geman-McClure scales of the flow start's rounds, metres."""


ONTO_ROBUST, ONTO_STEPS = 0.3, 8
"""Geman-McClure scale of the start from detections, metres, and its steps."""


_CARRIED = ("rectangle", "previous", "history", "lost", "tracked", "passed_over", "meters")


class FrameTracker:
    """Tracks one frame after the other; what one frame hands to the next lives here (host)."""

    def __init__(self, observations: Observations, tracker: Tracker, key: PRNGKeyArray):
        self.observations = observations
        self.character = observations.character
        self.cameras = observations.cameras
        self.tracker = tracker
        self.score = PoseScore(tracker.scored, self.character)
        plan = tracker.search
        self.search = BodySearch(observations, tracker.scored, plan, self.score, key) if plan is not None else None
        self.backward_search = tracker.backward_search if plan is not None else None
        self.refinement = (
            Refinement(observations, tracker.refine, tracker.detections) if tracker.refine is not None else None
        )
        self.rectangle: Rectangle | None = None
        self.previous: FrameImages | None = None
        self.history: MotionHistory | None = None
        self.lost = False
        self.face_bodies = dominant_bodies(self.character)
        self.outer_bodies = outer_halves(self.character)
        kept = self.backward_search.longest + 2 if self.backward_search is not None else 0
        self.tracked: deque[tuple[Tracked, FrameResult]] = deque(maxlen=kept)
        self.passed_over: list[FrameResult] = []
        self.meters: list[LightMeter] = []

    def state(self) -> dict[str, Any]:
        """Everything that the frames so far have left behind: with it, and the same inputs, another tracker goes on to
        the same bits."""
        return {
            **{name: getattr(self, name) for name in _CARRIED},
            "capacity": self.score.capacity,
            "search": None if self.search is None else self.search.state(),
            "observations": self.observations.state(),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Take over what `state` said."""
        for name in _CARRIED:
            setattr(self, name, state[name])
        self.score.capacity = state["capacity"]
        if self.search is not None:
            self.search.restore(state["search"])
        self.observations.restore(state["observations"])

    # Stages -----------------------------------------------------------------------------------------------------

    def flow_start(
        self, shown: FrameImages, before: FrameImages, base: Pose, clock: Clock
    ) -> tuple[Pose, Float[np.ndarray, "camera"]]:
        """The paper's [4]: the last frame carried over the surface, and where its points went; and the mean flow in
        pixels per view, which moves the rectangle."""
        with clock.stage("flow"):
            vertices = np.asarray(skin(self.character, base))
            rectangle = frame_rectangle(vertices, self.cameras, shown.frame, self.rectangle)
            sources = [
                [picture_source(self.character, self.cameras, image, before.frame, c, base)]
                for c, image in enumerate(before.images)
            ]
            plain = build_problem(
                shown.images, rectangle, self.cameras, shown.frame, vertices, self.observations.surface
            )
            crops = [rectangle.crop(image, c) for c, image in enumerate(shown.images)]
            speed = np.zeros(len(shown.images))
            pose = base
            prior = free_prior(self.character, base, np.repeat(np.array([0.1, 0.5], np.float32), [6, 33]))
            for round_index, robust in enumerate(FLOW_ROBUST):
                posed, ids, _ = draw(self.character, pose, plain)
                flows = surface_flow(self.character, posed, ids, crops, plain, sources, self.tracker.flow)
                delta, _ = descend(
                    self.character,
                    base,
                    difference(self.character.skeleton, base, pose),
                    tuple(Rows(lines, 0.02, robust) for lines in flows),
                    (),
                    prior,
                    Shooting(),
                    steps=2,
                )
                pose = retract(self.character.skeleton, base, delta)
                if round_index == 0:
                    speed = self._pixel_speed(base, pose, shown.frame)
        return pose, speed

    def _pixel_speed(self, before: Pose, after: Pose, frame: int) -> Float[np.ndarray, "camera"]:
        view = self.cameras.at(frame)
        moved = np.linalg.norm(np.asarray(skin(self.character, after) - skin(self.character, before)), axis=1).mean()
        depth = np.asarray(skin(self.character, after)).mean(0)
        return np.array(
            [
                k[0, 0] * moved / max(float(t[2, :3] @ depth + t[2, 3]), 0.1)
                for k, t in zip(np.asarray(view.intrinsics), np.asarray(view.cam_from_world), strict=True)
            ]
        )

    def _problem(self, shown: FrameImages, pose: Pose, speed, clock: Clock) -> tuple[FrameProblem, Rectangle]:
        with clock.stage("background"):
            vertices, before = np.asarray(skin(self.character, pose)), self.rectangle
            self.rectangle = frame_rectangle(vertices, self.cameras, shown.frame, before, speed)
            if before is not None and before.size != self.rectangle.size:
                jax.clear_caches()  # programs of the smaller rectangle are not needed again and hold 100 to 250 MB each
            edges = self.tracker.refine.edges if self.tracker.refine is not None else "canny"
            return self.observations.problem(shown, self.rectangle, pose, edges), self.rectangle

    # The frame --------------------------------------------------------------------------------------------------

    def first(self, shown: FrameImages, pose: Pose) -> FrameResult:
        """Take a registered pose as the answer of a frame, at which a sequence starts."""
        self.observations.restart()
        if self.tracker.light is not None:
            self.meters = [LightMeter.begin(image, self.tracker.light) for image in shown.images]
        clock = Clock()
        problem, rectangle = self._problem(shown, pose, np.zeros(len(shown.images)), clock)
        return self._finish(shown, problem, rectangle, pose, np.zeros(39), None, clock)

    def track(self, shown: FrameImages) -> FrameResult:
        """Find the pose of the next frame: flow start, search, refinement."""
        previous, past = self.previous, self.history
        assert previous is not None
        assert past is not None
        as_before = shown if previous.light is None else shown.in_light(previous.light)
        unknown = shown.frame not in self.observations.key_poses
        if unknown and past.steps <= self.tracker.longest_flash and lit_apart(as_before.images, previous.images):
            return self._pass_over(shown, past)
        clock = Clock()
        with clock.stage("light"):
            shown = self._in_first_light(shown)
        start, speed = past.pose, np.zeros(len(shown.images))
        if self.tracker.flow_start:
            start, speed = self.flow_start(shown, previous, past.pose, clock)
        problem, rectangle = self._problem(shown, start, speed, clock)
        with clock.stage("score"):
            pose = self._best_start(shown, problem, past, start)
        deviation, hessian = np.zeros(39), None

        def refined(pose: Pose) -> Pose:
            return pose if self.refinement is None else self.refinement(pose, shown, problem, rectangle, past)[0]

        if self.search is not None:
            pose, deviation = self.search(pose, problem, shown.frame, past, clock, refined, self.lost)
        if self.tracker.polish is not None:
            with clock.stage("polish"):
                pose, _, _ = polish(self.tracker.scored, self.character, pose, problem, self.tracker.polish)
        if self.refinement is not None:
            with clock.stage("refine"):
                pose, hessian = self.refinement(pose, shown, problem, rectangle, past)
        return self._finish(shown, problem, rectangle, pose, deviation, hessian, clock)

    def _in_first_light(self, shown: FrameImages) -> FrameImages:
        """The frame in the light of the one at which the sequence started."""
        settings = self.tracker.light
        if settings is None:
            return shown
        self.meters = [meter.at(image, settings) for meter, image in zip(self.meters, shown.images, strict=True)]
        factors = np.stack([meter.factors(settings) for meter in self.meters])
        return shown if (factors == 1).all() else shown.in_light(factors)

    def _best_start(self, shown: FrameImages, problem: FrameProblem, past: MotionHistory, start: Pose) -> Pose:
        """The last pose, the flow start or the registered pose, whichever scores best; with `prediction`, and with
        detections, its root, torso and limbs one by one where the last motion would lead, and where the detections are,
        if that scores better."""
        skeleton = self.character.skeleton
        candidates = [past.pose, start]
        if shown.frame in self.observations.key_poses:
            candidates.append(nearest_equivalent(skeleton, self.observations.key_poses[shown.frame], past.pose))
        totals, _ = self.score(problem, candidates)
        best = int(np.argmin(totals))
        pose = candidates[best]
        if best == 2:
            return pose
        if self.tracker.prediction and past.increments:
            ahead = retract(skeleton, past.pose, jnp.asarray(past.steps * past.increments[-1]))
            pose = self._towards(problem, pose, clamp(skeleton, ahead))
        if self.tracker.detections is not None and bool((problem.keypoints[..., 2] > 0).any()):
            pose = self._towards(problem, pose, self._onto_detections(problem, pose, self.tracker.detections))
        return pose

    def _towards(self, problem: FrameProblem, pose: Pose, goal: Pose) -> Pose:
        """The pose with those of its parts, root, torso or limb, moved to the goal that then score better."""
        skeleton = self.character.skeleton
        step = np.asarray(difference(skeleton, pose, goal))
        parts = np.stack([np.isin(np.arange(39), dofs) for _, dofs in skeleton.groups])
        moved = [retract(skeleton, pose, jnp.asarray(step * part)) for part in parts]
        totals, _ = self.score(problem, [pose, *moved, goal])
        gained = parts[totals[1:-1] < totals[0]].any(0)
        both = retract(skeleton, pose, jnp.asarray(step * gained))
        candidates, last = [pose, *moved, goal, both], self.score(problem, [both])[0]
        return candidates[int(np.argmin(np.append(totals, last)))]

    def _onto_detections(self, problem: FrameProblem, pose: Pose, plan: DetectionPlan) -> Pose:
        """The pose after a few steps of inverse kinematics to the detections' rays."""
        start = jnp.zeros(39)
        points = (detection_rays(self.character.skeleton, problem, plan, robust=ONTO_ROBUST),)
        prior = free_prior(self.character, pose, 0.05)
        delta, _ = descend(self.character, pose, start, (), points, prior, Shooting(), steps=ONTO_STEPS)
        return retract(self.character.skeleton, pose, delta)

    def search_backwards(self) -> list[FrameResult]:
        """Results of earlier frames that the last one has shown to be wrong, found anew; and those of frames that were
        passed over, between the frames before and after."""
        return [*self._between(), *self._found_anew()]

    def _between(self) -> list[FrameResult]:
        if not self.passed_over or self.history is None or self.history.steps > 1:
            return []
        found = between(self.character.skeleton, self.passed_over, self.history.pose)
        self.passed_over = []
        return found

    def _pass_over(self, shown: FrameImages, past: MotionHistory) -> FrameResult:
        """A frame in another light; the next one that can be tracked will tell its pose."""
        result = passed_over(self.character.skeleton, shown, past.pose, len(self.outer_bodies))
        self.passed_over.append(result)
        self.tracked.clear()
        self.history = past._replace(steps=past.steps + 1)
        return result

    def _found_anew(self) -> list[FrameResult]:
        if self.search is None or self.backward_search is None or len(self.tracked) < 3:
            return []
        with Clock(self.tracked[-1][1].seconds).stage("backward search"):
            frames = [frame for frame, _ in self.tracked]
            better = search_backwards(frames, self.search, self.refinement, self.backward_search)
        if not better:
            return []
        revised, history = [], frames[0].history
        for position, frame in enumerate(frames):
            frame, old = replace(frame, history=history), self.tracked[position][1]
            pose = better.get(position, frame.pose)
            if position in better:
                seen = look_at(self.character, pose, frame.problem)
                new = self._result(
                    *(frame.shown, frame.problem, frame.rectangle, pose, history, seen),
                    *(old.deviation, old.hessian, old.seconds),
                )
                frame, old = replace(frame, pose=pose, costs=new.limb_costs), new
                revised.append(new)
            self.tracked[position] = (frame, old)
            history = after(self.character.skeleton, history, frame.shown.timestamp, pose, self.tracker.angles)
        self.history = history
        return revised

    def _finish(
        self, shown: FrameImages, problem: FrameProblem, rectangle: Rectangle, pose: Pose, deviation, hessian, clock
    ) -> FrameResult:
        past = self.history
        with clock.stage("score"):
            seen = look_at(self.character, pose, problem)
            result = self._result(shown, problem, rectangle, pose, past, seen, deviation, hessian, clock.seconds)
        self.lost = result.status == "lost"
        if self.search is not None:
            self.search.learn(seen, pose)
            tracked = Tracked(past, shown, problem, rectangle, pose, result.limb_costs)
            self.tracked.append((tracked, result))
        self.previous = shown
        self.history = after(self.character.skeleton, past, shown.timestamp, pose, self.tracker.angles)
        with clock.stage("background"):
            self.observations.learn(shown, rectangle, pose)
        return result

    def _result(
        self,
        shown: FrameImages,
        problem: FrameProblem,
        rectangle: Rectangle,
        pose: Pose,
        past: MotionHistory | None,
        seen: Seen,
        deviation,
        hessian,
        seconds,
    ) -> FrameResult:
        """The record of a frame's answer."""
        _, terms = self.score(problem, [pose])
        speed = 0.0
        if past is not None:
            moved = np.asarray(difference(self.character.skeleton, past.pose, pose))
            speed = float(np.linalg.norm(moved[:3])) / max(abs(shown.timestamp - past.timestamp), 1e-3)
        left = unexplained(seen.ids, problem)
        verdict = judge(self.character, self.face_bodies, seen.ids, seen.costs, speed, self.tracker.verdict, left)
        names = [term.name for term in self.tracker.scored.terms]
        energy = {name: float(value) for name, value in zip(names, terms[0], strict=True)}
        energy["covered"] = verdict.covered_cost
        return FrameResult(
            shown.frame,
            shown.timestamp,
            pose,
            energy,
            verdict.confidence,
            verdict.status,
            deviation,
            hessian,
            seconds,
            mean_costs(self.outer_bodies, self.face_bodies, seen.ids, seen.costs),
            seen_shares(self.outer_bodies, self.character, self.face_bodies, seen.over),
            frame_signals(
                *(self.character, pose, shown, problem, rectangle, seen, self.face_bodies, self.outer_bodies),
                *(self.tracker.flow, speed),
            ),
        )
