"""From decoded images to arrays: the one doorway through which frames reach the tracker."""

import copy
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from jaxtyping import Float

from jaxmocap._results import InputError
from jaxmocap.appearance import Appearance, label_image
from jaxmocap.camera import Cameras
from jaxmocap.capture import Capture, Detections
from jaxmocap.character import Character, Pose, filled_up, skin

from ._background import Background, BackgroundModel
from ._detections import DetectorOffsets, expected_keypoints, nearest_person, stacked_keypoints
from ._features import FeatureSettings
from ._flow import FlowAhead
from ._problem import Frame, FrameImages, FrameProblem, build_problem
from ._rectangle import Rectangle, frame_rectangle
from ._surface import filled_surface, surface_of


class Registered(Protocol):
    """Anything that holds a registered pose."""

    @property
    def pose(self) -> Pose: ...


def key_poses_of(registrations: Mapping[int, Registered] | Mapping[int, Pose]) -> dict[int, Pose]:
    """Return the poses of registered frames."""
    return {frame: r if isinstance(r, Pose) else r.pose for frame, r in registrations.items()}


@dataclass
class Observations:
    """The frames of a capture as problems, made one by one while tracking: memory does not grow with length (host).

    Observations know nothing of the frames that were tracked before; what frames teach about the background goes in and
    comes out as a `Background`.

    Attributes:
        capture: the videos.
        cameras: one pinhole camera per view and frame.
        character: the person's skinned mesh.
        appearance: colour models of the person and the background, learnt at the selected frames.
        key_poses: the registered pose of every selected frame.
        features: how background points are found and matched.
        detections: a detector's keypoints, for `Tracker.detections`; without them every frame is judged by its pixels.
    """

    capture: Capture
    cameras: Cameras
    character: Character
    appearance: Appearance
    key_poses: dict[int, Pose]
    features: FeatureSettings = field(default_factory=FeatureSettings)
    detections: Detections | None = None

    def __post_init__(self) -> None:
        self.surface = surface_of(self.character, self.appearance, self.cameras.num_cameras)
        self._ahead = FlowAhead()  # copies of these observations share it: one decodes, another tracks
        self.background = self._background()

    def _background(self) -> BackgroundModel:
        return BackgroundModel(
            self.capture,
            self.cameras,
            self.character,
            self.appearance,
            self.key_poses,
            self.features,
            self._ahead,
        )

    def with_key_pose(self, frame: int, pose: Pose) -> "Observations":
        """Replace the registered pose at a selected frame in a copy of these observations."""
        other = copy.copy(self)
        other.key_poses = self.key_poses | {frame: pose}
        other.background = other._background()
        return other

    def filled_up(self) -> "Observations":
        """Fill the mesh up in a copy of these observations (`character.filled_up`): the programs of tracking then serve
        other characters too."""
        other = copy.copy(self)
        other.character = filled_up(self.character)
        other.surface = filled_surface(self.surface, other.character.faces.shape[0])
        other.background = other._background()
        return other

    def frames(self, leg: range) -> Iterator[FrameImages]:
        """Decode the frames of a leg in its order, streaming, one ahead; a leg may run backwards."""
        decoded = self._decoded(leg)
        if self.appearance.settings.behind != "plate":
            return decoded
        return self._ahead.follow(decoded, lambda shown: shown.images)

    def _decoded(self, leg: range) -> Iterator[FrameImages]:
        if leg.step == 1:
            for frame, images in self.capture.frames(leg.start, leg.stop):
                yield FrameImages(frame, float(self.capture.timestamps[frame]), images)
            return
        for frame in leg:
            images = [self.capture.image(camera, frame) for camera in range(self.capture.num_cameras)]
            yield FrameImages(frame, float(self.capture.timestamps[frame]), images)

    def observe(
        self,
        shown: FrameImages,
        rectangle: Rectangle,
        pose: Pose,
        background: Background,
        detector: DetectorOffsets | None = None,
    ) -> tuple[Frame, Background]:
        """Observe one frame as arrays, and what is known of the background with it. `pose` is the prediction,
        `detector` what is known of the detector."""
        vertices = np.asarray(skin(self.character, pose))
        labels = [
            np.asarray(label_image(self.appearance.palette, rectangle.crop(image, camera)))
            for camera, image in enumerate(shown.images)
        ]
        distances, background = self.background.distances(background, shown, rectangle, pose, labels)
        problem = build_problem(
            shown.images,
            rectangle,
            self.cameras,
            shown.frame,
            vertices,
            self.surface,
            labels,
            distances,
        )
        problem = problem.with_keypoints(
            self._detected(shown.frame, pose), None if detector is None else detector.metres()
        )
        return Frame(shown, rectangle, problem), background

    def at(self, frame: int, pose: Pose) -> Frame:
        """Observe the frame at a position by itself, in the rectangle around a pose near the answer.

        `observations.at(12, pose).problem` are the arrays that energies, `jm.polish` and `SearchBatch` take. Raises
        `InputError` where a camera does not see the pose, `IndexError` for a frame that the capture does not have.
        """
        rectangle = frame_rectangle(np.asarray(skin(self.character, pose)), self.cameras, frame)
        (shown,) = self._decoded(range(frame, frame + 1))
        return self.observe(shown, rectangle, pose, self.background.start())[0]

    def problem(self, shown: FrameImages, rectangle: Rectangle, pose: Pose) -> FrameProblem:
        """Observe one frame as arrays, by itself: its background is that of the selected frames."""
        return self.observe(shown, rectangle, pose, self.background.start())[0].problem

    def detector(self) -> DetectorOffsets:
        """Learn from the selected frames where the detector sees the landmarks."""
        known = DetectorOffsets.start()
        for frame, pose in sorted(self.key_poses.items()):
            points = self._detected(frame, pose)
            if points is not None:
                known = known.learn(self.character.skeleton, pose, self.cameras.at(frame), points)
        return known

    def _detected(self, frame: int, pose: Pose) -> Float[np.ndarray, "camera 25 3"] | None:
        """Choose the detections of the person whom `pose` predicts."""
        if self.detections is None:
            return None
        people = [self.detections.people(camera, frame) for camera in range(self.cameras.num_cameras)]
        expected = expected_keypoints(self.character, pose, self.cameras.at(frame))
        return stacked_keypoints([nearest_person(*each) for each in zip(people, expected, strict=True)])


def check_key_poses(capture: Capture, cameras: Cameras, key_poses: Mapping[int, Pose]) -> None:
    """Raise `InputError` unless there is a pose of a frame of the capture at least, and the cameras are its own."""
    if (cameras.num_cameras, cameras.num_frames) != (capture.num_cameras, capture.num_frames):
        raise InputError(
            f"capture '{capture.name}' has {capture.num_cameras} cameras and {capture.num_frames} frames, but the "
            f"cameras given are {cameras.num_cameras} with {cameras.num_frames}; give capture.cameras, or as many."
        )
    if not key_poses:
        raise InputError(f"no pose of capture '{capture.name}' is given; give those that jm.register finds.")
    if wrong := [frame for frame in key_poses if not 0 <= frame < capture.num_frames]:
        raise InputError(
            f"a pose is given for frame {wrong[0]}, but capture '{capture.name}' has frames 0 to "
            f"{capture.num_frames - 1}; give positions in the span that all cameras share."
        )


def observe(
    capture: Capture,
    cameras: Cameras,
    character: Character,
    appearance: Appearance,
    key_poses: Mapping[int, Registered] | Mapping[int, Pose],
    detections: Detections | None = None,
) -> Observations:
    """Observe a capture: its frames as problems, decoded one at a time while they are tracked.

    `key_poses` are poses at selected frames, or what `register` returns; `appearance` is learnt from the same. Raises
    `InputError` where there is none, or where cameras or frames are not the capture's.
    """
    poses = key_poses_of(key_poses)
    check_key_poses(capture, cameras, poses)
    return Observations(capture, cameras, character, appearance, poses, detections=detections)
