"""The frame that benchmarks score particles in."""

import tempfile
from pathlib import Path

import jax
import numpy as np

from jaxmocap.capture import Capture
from jaxmocap.character import Character, Pose, skin
from jaxmocap.observation import FrameImages, FrameProblem, Observations, place_rectangle, projected_box
from jaxmocap.pipeline import fit_capture_appearance
from jaxmocap.synthetic import make_capture, write_capture


def scene() -> tuple[Character, Pose, FrameProblem]:
    """A frame of the built-in capture at 960 x 540, as the tracker sees it."""
    truth = make_capture(3, (960, 540), sensor_noise=0.0)
    with tempfile.TemporaryDirectory() as folder:
        capture = Capture.open(write_capture(truth, Path(folder) / "capture"))
        poses = {frame: truth.pose(frame) for frame in truth.selected_frames}
        appearance = fit_capture_appearance(capture, truth.cameras, truth.character, poses, key=jax.random.key(0))
        observations = Observations(capture, truth.cameras, truth.character, appearance, poses)
        view, vertices = truth.cameras.at(2), np.asarray(skin(truth.character, truth.pose(2)))
        lenses = zip(np.asarray(view.intrinsics), np.asarray(view.cam_from_world), strict=True)
        boxes = [projected_box(vertices, matrix, pose) for matrix, pose in lenses]
        rectangle = place_rectangle(np.stack(boxes), np.zeros(2), truth.cameras.sizes, names=truth.cameras.names)
        shown = FrameImages(2, float(truth.timestamps[2]), list(truth.images[2]))
        return truth.character, truth.pose(2), observations.problem(shown, rectangle, truth.pose(2))
