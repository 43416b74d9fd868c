"""The relative pose of two static cameras from points seen by both: RANSAC, then robust refinement of the epipolar
distance."""

from typing import NamedTuple

import cv2  # noqa: F401  (before pycolmap: the other order crashes)
import numpy as np
import pycolmap
from jaxtyping import Float
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

_ERROR = 0.02  # of the person's size
_TRIALS = 4  # of RANSAC, with different seeds
_REFINED = 0.008  # of the person's size: scale of the loss
_SAME = np.radians(3.0)


class RelativePose(NamedTuple):
    """Where a second camera stands, seen from a first one.

    Attributes:
        pose: second_from_first, the baseline of length 1.
        cost: robust sum of squared epipolar distances, in standard deviations.
    """

    pose: Float[np.ndarray, "4 4"]
    cost: float


def relative_poses(
    first: Float[np.ndarray, "point 2"],
    second: Float[np.ndarray, "point 2"],
    size: tuple[float, float],
    seed: int,
) -> list[RelativePose]:
    """Find relative poses that explain points of two pictures, the best first.

    Points are on the plane at distance 1 (pixels minus the principal point, over the focal length), `size` is the
    person's there. RANSAC with the five-point method (Nister 2004) from several seeds, each refined by Cauchy's loss of
    Sampson's distance over all points; those that become the same count once.
    """
    found: list[RelativePose] = []
    unit = pycolmap.Camera(model="PINHOLE", width=2, height=2, params=[1.0, 1.0, 0.0, 0.0])
    scale = float(np.hypot(*size)) / np.sqrt(2)
    for trial in range(_TRIALS):
        options = pycolmap.RANSACOptions()
        options.max_error, options.random_seed = _ERROR * scale / (1 + trial % 2), seed + trial
        options.min_num_trials, options.max_num_trials = 500, 3000
        answer = pycolmap.estimate_essential_matrix(first, second, unit, unit, options)
        if answer is None:
            continue
        start = np.asarray(answer["cam2_from_cam1"].matrix())
        for flipped in (False, True):
            refined = _refined(first, second, _twisted(start) if flipped else start, _REFINED * scale)
            if refined is not None and not any(_alike(refined.pose, other.pose) for other in found):
                found.append(refined)
    return sorted(found, key=lambda one: one.cost)


def _twisted(pose: np.ndarray) -> np.ndarray:
    """Turn a pose to the other rotation of the same essential matrix's family, half a turn about the baseline.

    A mirrored plane's pose is near there. It begins another search; which is right is told by depth and by cost.
    """
    axis = pose[:, 3] / np.linalg.norm(pose[:, 3])
    turn = Rotation.from_rotvec(np.pi * axis).as_matrix()
    return np.column_stack([turn @ pose[:, :3], pose[:, 3]])


def _refined(first: np.ndarray, second: np.ndarray, start: np.ndarray, scale: float) -> RelativePose | None:
    a, b = (np.column_stack([points, np.ones(len(points))]) for points in (first, second))
    baseline = start[:, 3] / np.linalg.norm(start[:, 3])
    sides = np.linalg.svd(baseline[None])[2][1:]

    def parts(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        turn = Rotation.from_rotvec(values[:3]).as_matrix() @ start[:, :3]
        towards = baseline + values[3:] @ sides
        return turn, towards / np.linalg.norm(towards)

    def distances(values: np.ndarray) -> np.ndarray:
        turn, towards = parts(values)
        essential = np.cross(np.eye(3), towards).T @ turn
        lines, back = a @ essential.T, b @ essential
        length = np.sqrt(lines[:, 0] ** 2 + lines[:, 1] ** 2 + back[:, 0] ** 2 + back[:, 1] ** 2)
        return np.sum(b * lines, axis=1) / np.maximum(length, 1e-12) / scale

    answer = least_squares(distances, np.zeros(5), loss="cauchy", x_scale="jac", max_nfev=60)
    turn, towards = parts(answer.x)
    best = None
    for rotation, shift in ((turn, towards), (turn, -towards)):
        if _in_front(a, b, rotation, shift) > 0.7:
            best = np.eye(4)
            best[:3, :3], best[:3, 3] = rotation, shift
    return None if best is None else RelativePose(best, float(answer.cost))


def _in_front(a: np.ndarray, b: np.ndarray, rotation: np.ndarray, shift: np.ndarray) -> float:
    """Which part of the points lies before both cameras."""
    turned = a @ rotation.T
    normal = np.cross(turned, b)
    square = np.maximum(np.sum(normal**2, axis=1), 1e-15)
    near = np.sum(np.cross(b, shift) * normal, axis=1) / square
    far = np.sum(np.cross(turned, shift) * normal, axis=1) / square
    return float(np.mean((near > 0) & (far > 0)))


def _alike(one: np.ndarray, other: np.ndarray) -> bool:
    turn = Rotation.from_matrix(one[:3, :3] @ other[:3, :3].T).magnitude()
    return bool(turn < _SAME and one[:3, 3] @ other[:3, 3] > np.cos(2 * _SAME))
