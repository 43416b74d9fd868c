"""One frame: start, search, refine, judge. Sec. 4 of the paper from top to bottom."""

from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Protocol

import numpy as np
from jaxtyping import Float, PRNGKeyArray

from jaxmocap._cache import free_programs
from jaxmocap._runtime import Clock
from jaxmocap.character import Pose, difference, skin
from jaxmocap.motion import MotionHistory, after, usual_interval
from jaxmocap.observation import Frame, FrameImages, LightMeter, Observations, frame_rectangle
from jaxmocap.refinement import Refinement
from jaxmocap.search import BodySearch, DrawnPose, Evidence, PoseScore, polish
from jaxmocap.verdict import FrameResult, frame_signals, judge_frame

from ._backward_search import search_backwards
from ._light import filled_in, in_first_light, in_flash, pass_over
from ._search_again import search_again
from ._start import best_start, flow_start
from ._state import Tracked, TrackingState, known
from ._tracker import Tracker


class Step(NamedTuple):
    """The state after a frame, its result, and new results of earlier frames that it has shown to be wrong."""

    state: TrackingState
    result: FrameResult
    revised: tuple[FrameResult, ...] = ()


class Worker(Protocol):
    """Tracks the frames of one sequence in order: the tracker's own `FrameTracker`, or a baseline's."""

    def first(self, shown: FrameImages, pose: Pose) -> Step: ...

    def track(self, state: TrackingState, shown: FrameImages) -> Step: ...

    def sizes(self) -> dict[str, Any]: ...

    def restore_sizes(self, sizes: dict[str, Any]) -> None: ...


@dataclass(frozen=True)
class Answer:
    """A pose with the deviation of the last particles and the refinement's J^T J, where there were any."""

    pose: Pose
    deviation: Float[np.ndarray, "dof"]
    hessian: Float[np.ndarray, "dof dof"] | None = None


class FrameTracker:
    """Tracks one frame after the other (host). It holds what follows from its inputs alone; what one frame hands to the
    next is a `TrackingState`, and every stage takes the state and the frame and returns what it has changed."""

    def __init__(self, observations: Observations, tracker: Tracker, key: PRNGKeyArray):
        self.observations = observations.filled_up()
        self.character = self.observations.character
        self.tracker = tracker
        self.interval = usual_interval(observations.capture.timestamps)
        self.evidence = Evidence.of(self.character)
        self.score = PoseScore(tracker.scored, self.character)
        search, refine = tracker.search, tracker.refine
        scored = (self.score, self.evidence, key)
        self.body_search = (
            None if search is None else BodySearch(observations, tracker.scored, search, tracker.sampler, *scored)
        )
        self.refinement = (
            None if refine is None else Refinement(self.observations, refine, tracker.flow, tracker.detections)
        )

    def first(self, shown: FrameImages, pose: Pose) -> Step:
        """Take a registered pose as the answer of a frame, at which a sequence starts."""
        state = TrackingState(
            self.observations.background.start(),
            detector=None if self.tracker.detections is None else self.observations.detector(),
            light=tuple(LightMeter.begin(image) for image in shown.images) if self.tracker.light else (),
            search=None if self.body_search is None else self.body_search.start(),
        )
        clock = Clock()
        frame, state = self.observe(state, shown, pose, np.zeros(len(shown.images)), clock)
        return self.judge(state, frame, Answer(pose, np.zeros(self.character.skeleton.num_dofs)), clock)

    def track(self, state: TrackingState, shown: FrameImages) -> Step:
        """Find the pose of the next frame: start, search, refine, judge."""
        registered = shown.frame in self.observations.key_poses
        if not registered and in_flash(state, shown, self.tracker.longest_flash):
            return Step(*pass_over(state, shown, self.character.skeleton, len(self.evidence.distal)))
        clock = Clock()
        if self.tracker.light:
            with clock.stage("light"):
                shown, state = in_first_light(state, shown)
        frame, start, state = self.start(state, shown, clock)
        pose, deviation, state = self.search(state, frame, start, clock)
        answer = self.refine(state, frame, Answer(pose, deviation), clock)
        return self.judge(state, frame, answer, clock)

    def start(self, state: TrackingState, shown: FrameImages, clock: Clock) -> tuple[Frame, Pose, TrackingState]:
        """Observe the frame as arrays, and choose where its search starts: the flow start, or what scores better."""
        history, previous = known(state)
        flow, speed = history.pose, np.zeros(len(shown.images))
        if self.tracker.flow_start:
            with clock.stage("flow"):
                flow, speed = flow_start(
                    self.observations, self.tracker.flow, state.rectangle, previous, history.pose, shown
                )
        frame, state = self.observe(state, shown, flow, speed, clock)
        with clock.stage("score"):
            registered = self.observations.key_poses.get(shown.frame)
            return frame, best_start(self.score, self.tracker, frame, flow, history, registered), state

    def observe(
        self, state: TrackingState, shown: FrameImages, pose: Pose, speed: Float[np.ndarray, "camera"], clock: Clock
    ) -> tuple[Frame, TrackingState]:
        """Observe the frame as arrays around a predicted pose that moves by so many pixels per view."""
        with clock.stage("background"):
            vertices, before = np.asarray(skin(self.character, pose)), state.rectangle
            rectangle = frame_rectangle(vertices, self.observations.cameras, shown.frame, before, speed)
            if before is not None and before.size != rectangle.size:
                free_programs()  # those of the smaller rectangle are not needed again and hold 100 to 250 MB each
            frame, background = self.observations.observe(shown, rectangle, pose, state.background, state.detector)
            return frame, state._replace(rectangle=rectangle, background=background)

    def search(
        self, state: TrackingState, frame: Frame, start: Pose, clock: Clock
    ) -> tuple[Pose, Float[np.ndarray, "dof"], TrackingState]:
        """Search the pose from this start; return it with the deviation of the last particles (sec. 4.1)."""
        pose, deviation = start, np.zeros(self.character.skeleton.num_dofs)
        if self.body_search is not None:
            memory = state.search
            assert memory is not None
            pose, deviation, memory = self.body_search(frame, pose, state.history, memory, clock, state.lost)
            if (retry := self.body_search.plan.retry) is not None:
                with clock.stage("search again"):
                    pose, memory = search_again(
                        self.body_search, self.refinement, retry, frame, start, pose, state.history, memory
                    )
            state = state._replace(search=memory)
        if self.tracker.polish is not None:
            with clock.stage("polish"):
                pose, _, _ = polish(self.tracker.scored, self.character, pose, frame.problem, self.tracker.polish)
        return pose, deviation, state

    def refine(self, state: TrackingState, frame: Frame, answer: Answer, clock: Clock) -> Answer:
        """Refine the answer locally (sec. 4.2)."""
        if self.refinement is None:
            return answer
        with clock.stage("refine"):
            pose, hessian = self.refinement(frame, answer.pose, state.history)
            return replace(answer, pose=pose, hessian=hessian)

    def judge(self, state: TrackingState, frame: Frame, answer: Answer, clock: Clock) -> Step:
        """Judge a frame's answer: its result, what it teaches the next frame, and what is wrong in earlier ones."""
        before, shown = state.history, frame.shown
        with clock.stage("score"):
            drawn = self.evidence.draw(answer.pose, frame.problem)
            result = self.result(frame, answer, drawn, before, clock.seconds)
        if self.body_search is not None:
            assert state.search is not None
            kept = self.tracker.backward_search.longest + 2 if self.tracker.backward_search is not None else 0
            recent = (*state.recent, Tracked(before, frame, result))
            state = state._replace(
                search=self.body_search.remember(state.search, drawn), recent=recent[-kept:] if kept else ()
            )
        with clock.stage("background"):
            background = self.observations.background.learn(state.background, shown, frame.rectangle, answer.pose)
        between = filled_in(state, shown, self.character.skeleton, answer.pose)
        detector = state.detector
        if detector is not None and result.status == "ok":
            view = self.observations.cameras.at(frame.number)
            points = np.asarray(frame.problem.keypoints)
            detector = detector.learn(self.character.skeleton, answer.pose, view, points)
        state = state._replace(
            background=background,
            detector=detector,
            previous=shown,
            history=self._after(before, shown.timestamp, answer.pose),
            lost=result.status == "lost",
            passed_over=(),
        )
        state, revised = self._revise(state, clock)
        return Step(state, result, (*between, *revised))

    def result(
        self, frame: Frame, answer: Answer, drawn: DrawnPose, history: MotionHistory | None, seconds: dict[str, float]
    ) -> FrameResult:
        """Record a frame's answer."""
        _, terms = self.score(frame.problem, [answer.pose])
        speed = 0.0
        if history is not None:
            moved = np.asarray(difference(self.character.skeleton, history.pose, answer.pose))
            speed = float(np.linalg.norm(moved[:3])) / max(abs(frame.timestamp - history.timestamp), 1e-3)
        confidence, status, covered_cost = judge_frame(self.evidence, drawn, self.tracker.verdict, speed)
        names = [term.name for term in self.tracker.scored.terms]
        energy = {name: float(value) for name, value in zip(names, terms[0], strict=True)}
        energy["covered"] = covered_cost
        return FrameResult(
            frame.number,
            frame.timestamp,
            answer.pose,
            energy,
            confidence,
            status,
            answer.deviation,
            answer.hessian,
            seconds,
            self.evidence.limb_costs(drawn),
            self.evidence.limb_shares(drawn),
            frame_signals(self.evidence, frame, drawn, self.tracker.flow, speed),
        )

    def sizes(self) -> dict[str, Any]:
        """Return the static sizes of the compiled programs, which only grow.

        With them and a state another process goes on to the same bits.
        """
        search = self.body_search
        return {"score": self.score.capacity, "search": None if search is None else search.sizes()}

    def restore_sizes(self, sizes: dict[str, Any]) -> None:
        """Take over what `sizes` said."""
        self.score.capacity = sizes["score"]
        if self.body_search is not None:
            self.body_search.restore_sizes(sizes["search"])

    def _revise(self, state: TrackingState, clock: Clock) -> tuple[TrackingState, list[FrameResult]]:
        """Revise the results of earlier frames, and the state that follows from them."""
        settings = self.tracker.backward_search
        if self.body_search is None or settings is None or len(state.recent) < 3:
            return state, []
        with clock.stage("backward search"):
            better = search_backwards(state.recent, self.body_search, self.refinement, settings)
        if not better:
            return state, []
        recent, revised, history = [], [], state.recent[0].history
        for position, (_, frame, result) in enumerate(state.recent):
            if position in better:
                answer = Answer(better[position], result.deviation, result.hessian)
                drawn = self.evidence.draw(answer.pose, frame.problem)
                result = self.result(frame, answer, drawn, history, result.seconds)
                revised.append(result)
            recent.append(Tracked(history, frame, result))
            history = self._after(history, frame.timestamp, result.pose)
        return state._replace(recent=tuple(recent), history=history), revised

    def _after(self, history: MotionHistory | None, timestamp: float, pose: Pose) -> MotionHistory:
        return after(self.character.skeleton, history, timestamp, pose, self.tracker.angles, self.interval)
