"""What all baselines share: the tracker's frame loop, with another way to find a frame's pose."""

import abc
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import PRNGKeyArray

from jaxmocap._runtime import Clock
from jaxmocap.character import Pose, clamp, nearest_equivalent, retract
from jaxmocap.motion import MotionHistory
from jaxmocap.observation import FrameImages, FrameProblem, Observations, Rectangle
from jaxmocap.track import FrameTracker, Tracker
from jaxmocap.verdict import FrameResult, VerdictSettings


class Follower(FrameTracker):
    """Tracks one frame after the other with `baseline.find` in place of flow start, search and refinement (host).

    Energies, confidence and status of the results are those of Eq. 5 for whatever pose was found, so that all methods
    are recorded alike.
    """

    def __init__(self, baseline: "Baseline", observations: Observations, key: PRNGKeyArray):
        tracker = Tracker.preset("normal")
        plain = Tracker(tracker.search_energy, search=None, refine=None, verdict=baseline.verdict)
        super().__init__(observations, plain, key)
        self.baseline = baseline
        self.memory: Any = baseline.learn_appearance(observations)

    def track(self, shown: FrameImages) -> FrameResult:
        past = self.history
        assert past is not None
        clock, skeleton = Clock(), self.character.skeleton
        if shown.frame in self.observations.key_poses:
            start = nearest_equivalent(skeleton, self.observations.key_poses[shown.frame], past.pose)
        else:
            start = self.baseline.start(self, past)
        problem, rectangle = self._problem(shown, start, np.zeros(len(shown.images)), clock)
        with clock.stage(self.baseline.name):
            pose = self.baseline.find(self, shown, problem, rectangle, start)
        return self._finish(shown, problem, rectangle, pose, np.zeros(39), None, clock)


@dataclass(frozen=True)
class Baseline(abc.ABC):
    """A competitor of the tracker behind the tracker's interface: `jm.track(observations, tracker=baseline)` starts
    from the same registered pose and sees the same cameras, mesh and selected frames. At later selected frames the
    registered pose is where it starts from."""

    verdict: VerdictSettings = field(default_factory=VerdictSettings, kw_only=True)

    name = "baseline"

    def follow(self, observations: Observations, key: PRNGKeyArray) -> Follower:
        """The worker of one sequence."""
        return Follower(self, observations, key)

    def learn_appearance(self, observations: Observations) -> Any:
        """What the method knows of colours before the first frame; kept as `Follower.memory`."""
        return None

    def start(self, worker: Follower, past: MotionHistory) -> Pose:
        """Where a frame begins: the pose that the autoregression of Eq. 10 predicts."""
        skeleton = worker.character.skeleton
        return clamp(skeleton, retract(skeleton, past.pose, past.predicted("ridge")))

    @abc.abstractmethod
    def find(
        self, worker: Follower, shown: FrameImages, problem: FrameProblem, rectangle: Rectangle, start: Pose
    ) -> Pose:
        """The pose of one frame."""
