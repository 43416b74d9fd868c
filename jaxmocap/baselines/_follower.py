"""What all baselines share: the tracker's frame loop, with another way to find a frame's pose."""

import abc
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from jaxtyping import Bool, PRNGKeyArray

from jaxmocap._runtime import Clock
from jaxmocap.character import Pose, clamp, nearest_equivalent, retract
from jaxmocap.motion import MotionHistory
from jaxmocap.observation import Frame, FrameImages, Observations
from jaxmocap.refinement import FlowSettings
from jaxmocap.track import Answer, FrameTracker, Step, Tracker, TrackingState, flow_start
from jaxmocap.verdict import VerdictSettings

MaskSource = Callable[[int, int], Bool[np.ndarray, "height width"] | None]
"""Gives the person's mask over the whole picture of a camera at a frame, or None where it has none: `Capture.mask`."""


def given_masks(masks: MaskSource | None, frame: Frame) -> list[Bool[np.ndarray, "height width"] | None]:
    """Crop the masks that are given for a frame to its rectangle, one per view; None where none is given."""
    views = range(len(frame.shown.images))
    whole = [None if masks is None else masks(camera, frame.number) for camera in views]
    return [None if mask is None else frame.rectangle.crop(mask, camera) for camera, mask in enumerate(whole)]


class Follower:
    """Tracks one frame after the other with `baseline.find` in place of flow start, search and refinement (host).

    `frames` observes and judges: energies, confidence and status of the results are those of Eq. 5 for whatever pose
    was found, so that all methods are recorded alike. `memory` is what `baseline.learn_appearance` made.
    """

    def __init__(self, baseline: "Baseline", observations: Observations, key: PRNGKeyArray):
        tracker = Tracker.preset("normal")
        plain = Tracker(tracker.search_energy, search=None, refine=None, verdict=baseline.verdict)
        self.frames = FrameTracker(observations, plain, key)
        self.baseline = baseline
        self.character = observations.character
        self.cameras = observations.cameras
        self.memory: Any = baseline.learn_appearance(observations)

    def first(self, shown: FrameImages, pose: Pose) -> Step:
        """Take a registered pose as the answer of a frame, at which a sequence starts."""
        return self.frames.first(shown, pose)

    def track(self, state: TrackingState, shown: FrameImages) -> Step:
        """Find the pose of the next frame: start, then the baseline."""
        history, previous, clock = state.history, state.previous, Clock()
        assert history is not None
        assert previous is not None
        speed = np.zeros(len(shown.images))
        registered = self.frames.observations.key_poses.get(shown.frame)
        if registered is not None:
            start = nearest_equivalent(self.character.skeleton, registered, history.pose)
        elif self.baseline.begin == "flow":
            with clock.stage("flow"):
                start, speed = flow_start(
                    self.frames.observations, FlowSettings(), state.rectangle, previous, history.pose, shown
                )
        else:
            start = self.baseline.start(self, history, shown.timestamp)
        frame, state = self.frames.observe(state, shown, start, speed, clock)
        with clock.stage(self.baseline.name):
            pose = self.baseline.find(self, frame, start)
        return self.frames.judge(state, frame, Answer(pose, np.zeros(self.character.skeleton.num_dofs)), clock)

    def sizes(self) -> dict[str, Any]:
        """Return the static sizes of the compiled programs."""
        return self.frames.sizes()

    def restore_sizes(self, sizes: dict[str, Any]) -> None:
        """Take over what `sizes` said."""
        self.frames.restore_sizes(sizes)


@dataclass(frozen=True)
class Baseline(abc.ABC):
    """A competitor of the tracker behind the tracker's interface: `jm.track(observations, tracker=baseline)` starts
    from the same registered pose and sees the same cameras, mesh and selected frames. At later selected frames the
    registered pose is where it starts from.

    Attributes:
        begin: "own" as the publication says; "flow" begins every other frame where optical flow leads from the last
            pose, as the tracker's does.
        verdict: when a frame or a part of it is doubtful or lost, as of the tracker.
    """

    begin: Literal["own", "flow"] = field(default="own", kw_only=True)
    verdict: VerdictSettings = field(default_factory=VerdictSettings, kw_only=True)

    name = "baseline"

    def follow(self, observations: Observations, key: PRNGKeyArray) -> Follower:
        """Make the worker of one sequence."""
        return Follower(self, observations, key)

    def learn_appearance(self, observations: Observations) -> Any:
        """Learn what the method knows of colours before the first frame; kept as `Follower.memory`."""
        return None

    def start(self, worker: Follower, history: MotionHistory, timestamp: float) -> Pose:
        """Predict by the autoregression of Eq. 10 the pose at which a frame begins, which is shown at a time in
        seconds."""
        skeleton = worker.character.skeleton
        return clamp(skeleton, retract(skeleton, history.pose, history.predicted("ridge", timestamp)))

    @abc.abstractmethod
    def find(self, worker: Follower, frame: Frame, start: Pose) -> Pose:
        """Find the pose of one frame."""
