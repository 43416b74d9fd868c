"""A small filmed world of which everything is known, shared by the tests of energies, observation and tracking.

Three frames of two views without sensor noise. The appearance is fitted at the true poses through files, as a user
would; the problems of single frames are made of the images before compression.
"""

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import jax
import numpy as np
import pytest

from jaxmocap.appearance import Appearance
from jaxmocap.capture import Capture
from jaxmocap.character import Character, Pose, skin
from jaxmocap.observation import (
    FrameImages,
    FrameProblem,
    Observations,
    Rectangle,
    fit_capture_appearance,
    place_rectangle,
    projected_box,
)
from jaxmocap.synthetic import SyntheticCapture, make_capture, write_capture

SIZE = (480, 270)


@dataclass(frozen=True, eq=False)
class World:
    truth: SyntheticCapture
    capture: Capture
    appearance: Appearance

    @property
    def character(self) -> Character:
        return self.truth.character

    @property
    def cameras(self):
        return self.truth.cameras

    @property
    def key_poses(self) -> dict[int, Pose]:
        return {frame: self.truth.pose(frame) for frame in self.truth.selected_frames}

    def pose(self, frame: int) -> Pose:
        """The true pose."""
        return self.truth.pose(frame)

    def vertices(self, frame: int) -> np.ndarray:
        """The true surface."""
        return np.asarray(skin(self.character, self.pose(frame)))

    def observations(self) -> Observations:
        """Fresh ones: they remember the frames they have seen."""
        return Observations(self.capture, self.cameras, self.character, self.appearance, self.key_poses)

    def shown(self, frame: int) -> FrameImages:
        """A frame without compression."""
        return FrameImages(frame, float(self.truth.timestamps[frame]), list(self.truth.images[frame]))

    def rectangle(self, frame: int) -> Rectangle:
        """The rectangle around the truth."""
        view = self.cameras.at(frame)
        boxes = [
            projected_box(self.vertices(frame), np.asarray(view.intrinsics[c]), np.asarray(view.cam_from_world[c]))
            for c in range(self.cameras.num_cameras)
        ]
        return place_rectangle(np.stack(boxes), np.zeros(len(boxes)), self.cameras.sizes, names=self.cameras.names)

    def problem(self, frame: int) -> FrameProblem:
        """The frame as the tracker sees it when its prediction is right."""
        return _problem(self, frame)

    def masks(self, frame: int) -> np.ndarray:
        """The true masks in the rectangle."""
        rectangle = self.rectangle(frame)
        return np.stack([rectangle.crop(mask, camera) for camera, mask in enumerate(self.truth.masks[frame])])


@cache
def _problem(world: World, frame: int) -> FrameProblem:
    return world.observations().problem(world.shown(frame), world.rectangle(frame), world.pose(frame))


def shared_world(factory: pytest.TempPathFactory) -> World:
    """The same one for all tests of a session."""
    return _build_world(factory.getbasetemp() / "synthetic_world")


@cache
def _build_world(folder: Path) -> World:
    truth = make_capture(3, SIZE, sensor_noise=0.0)
    capture = Capture.open(write_capture(truth, folder))
    poses = {frame: truth.pose(frame) for frame in truth.selected_frames}
    appearance = fit_capture_appearance(capture, truth.cameras, truth.character, poses, key=jax.random.key(0))
    return World(truth, capture, appearance)
