"""Two cameras that drift, and the sentence with which a file of theirs is refused."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxmocap._results import InputError
from jaxmocap.camera import read_cameras

SIZES = [(960, 540), (640, 480)]
NAMES = ("left", "right")


def drifting_poses(count: int = 5, seed: int = 0) -> np.ndarray:
    """cam_from_world (camera, frame, 4, 4): two cameras about 3 m apart that drift."""
    rng = np.random.default_rng(seed)
    poses = np.tile(np.eye(4), (2, count, 1, 1))
    for camera in range(2):
        for frame in range(count):
            poses[camera, frame, :3, :3] = Rotation.from_rotvec([0.1, 0.4 * camera, 0.01 * frame]).as_matrix()
            poses[camera, frame, :3, 3] = [3 * camera, 0.1 * frame, 4] + 0.01 * rng.normal(size=3)
    return poses


def refusal(path: Path, num_frames: int = 5, **arguments) -> str:
    with pytest.raises(InputError) as caught:
        read_cameras(path, NAMES, num_frames, **({"sizes": SIZES} | arguments))
    assert "\n" not in str(caught.value)
    return str(caught.value)
