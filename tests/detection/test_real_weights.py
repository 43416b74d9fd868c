"""The real networks on the path-traced capture, where a user's cache has the weights."""

from pathlib import Path

import numpy as np
import pytest

from jaxmocap.capture import Capture
from jaxmocap.detection import LAYOUTS, follow_person, get_weights, open_model

KEPT = Path.home() / ".cache" / "jaxmocap" / "weights"
LIMBS = [f"{side}_{joint}" for side in "lr" for joint in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")]


def test_blazepose_finds_the_limbs_of_the_dancing_man(data):
    pytest.importorskip("ai_edge_litert", reason="the extra detect is not installed")
    if not (KEPT / "pose_landmark_heavy.tflite").is_file():
        pytest.skip(f"no weights in {KEPT}; jaxmocap detect puts them there")
    capture = Capture.open(data / "plaza")
    model = open_model(get_weights("heavy", KEPT))
    found = follow_person((images[0] for _, images in capture.frames(0, 4)), model)
    cameras = capture.cameras
    truth = np.load(data / "plaza" / "truth.npz")
    joints = truth["joints"][:4, [truth["joint_names"].tolist().index(name) for name in LIMBS]]
    poses, matrix = np.asarray(cameras.cam_from_world)[0, :4], np.asarray(cameras.intrinsics)[0]
    pixels = (np.einsum("tij,tnj->tni", poses[:, :3, :3], joints) + poses[:, None, :3, 3]) @ matrix.T
    points = found.points[:, [LAYOUTS["blazepose33"].points.index(name) for name in LIMBS]]
    errors = np.linalg.norm(points[..., :2] - pixels[..., :2] / pixels[..., 2:], axis=-1)
    assert (points[..., 2] > 0.3).all()
    assert np.median(errors) < 7
    assert np.percentile(errors, 90) < 14
