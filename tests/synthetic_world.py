"""A small filmed world of which everything is known, shared by the tests of energies, observation and tracking.

Three frames of two views without sensor noise. The appearance is fitted at the true poses through files, as a user
would; the problems of single frames are made of the images before compression.
"""

import json
import os
import pickle
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from filelock import FileLock

from jaxmocap.appearance import Appearance
from jaxmocap.camera import project
from jaxmocap.capture import Capture, Detections
from jaxmocap.character import Character, Pose, landmark_positions, skin
from jaxmocap.observation import (
    Frame,
    FrameImages,
    FrameProblem,
    Observations,
    Rectangle,
    place_rectangle,
    projected_box,
)
from jaxmocap.pipeline import fit_capture_appearance
from jaxmocap.synthetic import SyntheticCapture, make_capture, write_capture

SIZE = (480, 270)
POINTS = {
    "nose": 0, "r_shoulder": 2, "r_elbow": 3, "r_wrist": 4, "l_shoulder": 5, "l_elbow": 6, "l_wrist": 7, "r_hip": 9,
    "r_knee": 10, "r_ankle": 11, "l_hip": 12, "l_knee": 13, "l_ankle": 14, "l_toe": 19, "l_heel": 21, "r_toe": 22,
    "r_heel": 24,
}  # fmt: skip
MIDDLES = {1: ("l_shoulder", "r_shoulder"), 8: ("l_hip", "r_hip")}

"""Of BODY_25, those that one landmark is, and those between two."""


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

    def keypoints(self, frame: int, pose: Pose | None = None) -> np.ndarray:
        """BODY_25 points (camera, 25, 3) without error, of the true pose or another one; eyes, ears and small toes are
        not found."""
        skeleton, view = self.character.skeleton, self.cameras.at(frame)
        places = np.asarray(landmark_positions(skeleton, self.pose(frame) if pose is None else pose))
        at = dict(zip(skeleton.landmark_names, places, strict=True))
        body = np.zeros((25, 3), np.float32)
        for name, index in POINTS.items():
            body[index] = at[name]
        for index, (left, right) in MIDDLES.items():
            body[index] = 0.5 * (at[left] + at[right])
        pixels, _ = project(view.intrinsics, view.cam_from_world, jnp.asarray(body))
        found = np.isin(np.arange(25), [*POINTS.values(), *MIDDLES]).astype(np.float32)
        return np.stack([np.concatenate([np.asarray(p), found[:, None]], 1) for p in pixels])

    def write_keypoints(self, folder: Path, frames: Iterable[int]) -> Path:
        """Those of the truth as a detector's files."""
        folder.mkdir(exist_ok=True)
        for frame in frames:
            for camera, points in zip(self.capture.camera_names, self.keypoints(frame).astype(float), strict=True):
                person = {"pose_keypoints_2d": points.ravel().tolist()}
                file = folder / f"{camera}_{frame:05d}_keypoints.json"
                file.write_text(json.dumps({"people": [person]}))
        return folder

    def observations(self, detections: Detections | None = None) -> Observations:
        """Fresh ones, for tests that change them."""
        return Observations(
            self.capture, self.cameras, self.character, self.appearance, self.key_poses, detections=detections
        )

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

    def frame(self, frame: int, shown: FrameImages | None = None, observations: Observations | None = None) -> Frame:
        """The same with its images, or others; with a tracker's `observations` it has their table of colours, so that
        all tests of tracking share their programs."""
        problem = self.problem(frame)
        if observations is not None:
            problem = replace(problem, surface=observations.surface)
        return Frame(self.shown(frame) if shown is None else shown, self.rectangle(frame), problem)

    def masks(self, frame: int) -> np.ndarray:
        """The true masks in the rectangle."""
        rectangle = self.rectangle(frame)
        return np.stack([rectangle.crop(mask, camera) for camera, mask in enumerate(self.truth.masks[frame])])


@cache
def _problem(world: World, frame: int) -> FrameProblem:
    return world.observations().problem(world.shown(frame), world.rectangle(frame), world.pose(frame))


def shared_world(factory: pytest.TempPathFactory) -> World:
    """The same one for all tests of a session; the worker that needs it first makes it."""
    base = factory.getbasetemp()
    return _world(base.parent if "PYTEST_XDIST_WORKER" in os.environ else base)


@contextmanager
def _optimised() -> Iterator[None]:
    """Programs as for users: to cluster colours takes far longer than to compile it, whichever file asks first."""
    before = jax.config.read("jax_disable_most_optimizations")
    jax.config.update("jax_disable_most_optimizations", False)
    try:
        yield
    finally:
        jax.config.update("jax_disable_most_optimizations", before)


@cache
def _world(base: Path) -> World:
    folder, learnt = base / "synthetic_world", base / "synthetic_world.pickle"
    with FileLock(base / "synthetic_world.lock"):
        if not learnt.exists():
            truth = make_capture(3, SIZE, sensor_noise=0.0)
            capture = Capture.open(write_capture(truth, folder))
            poses = {frame: truth.pose(frame) for frame in truth.selected_frames}
            key = jax.random.key(0)
            with _optimised():
                appearance = fit_capture_appearance(capture, truth.cameras, truth.character, poses, key=key)
            learnt.write_bytes(pickle.dumps((truth, appearance)))
    truth, appearance = pickle.loads(learnt.read_bytes())
    return World(truth, Capture.open(folder), appearance)
