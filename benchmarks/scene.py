"""The frames that benchmarks score particles in."""

import tempfile
from pathlib import Path

import jax
import numpy as np

from jaxmocap.capture import Capture
from jaxmocap.character import Character, Pose, skin
from jaxmocap.observation import Frame, FrameImages, FrameProblem, Observations, place_rectangle, projected_box
from jaxmocap.pipeline import fit_capture_appearance
from jaxmocap.synthetic import SyntheticCapture, make_capture, write_capture


def scene() -> tuple[Character, Pose, FrameProblem]:
    """A frame of the built-in capture at 960 x 540, as the tracker sees it."""
    truth = make_capture(3, (960, 540), sensor_noise=0.0)
    return truth.character, truth.pose(2), observed(truth, 2)[1].problem


def observed(truth: SyntheticCapture, number: int) -> tuple[Observations, Frame]:
    """A frame as a tracker sees it whose prediction is right, with the appearance learnt at the true poses."""
    with tempfile.TemporaryDirectory() as folder:
        capture = Capture.open(write_capture(truth, Path(folder) / "capture"))
        poses = {frame: truth.pose(frame) for frame in truth.selected_frames}
        appearance = fit_capture_appearance(capture, truth.cameras, truth.character, poses, key=jax.random.key(0))
        observations = Observations(capture, truth.cameras, truth.character, appearance, poses)
        view, vertices = truth.cameras.at(number), np.asarray(skin(truth.character, truth.pose(number)))
        lenses = zip(np.asarray(view.intrinsics), np.asarray(view.cam_from_world), strict=True)
        boxes = [projected_box(vertices, matrix, pose) for matrix, pose in lenses]
        rectangle = place_rectangle(np.stack(boxes), np.zeros(2), truth.cameras.sizes, names=truth.cameras.names)
        shown = FrameImages(number, float(truth.timestamps[number]), list(truth.images[number]))
        return observations, Frame(shown, rectangle, observations.problem(shown, rectangle, truth.pose(number)))
