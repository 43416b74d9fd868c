"""Where a point seen in one view may lie in another: the image of its ray."""

from itertools import pairwise

import numpy as np
from jaxtyping import Float

from jaxmocap.camera import Cameras
from jaxmocap.capture import Undistortion

_NEAREST = 1e-3  # metres before the second camera
_SAMPLES = 33  # of a line that the lens bends

Box = tuple[float, float, float, float]
"""Left, top, right, bottom in pixels."""


def epipolar_segment(
    intrinsics: Float[np.ndarray, "2 3 3"],
    cam_from_world: Float[np.ndarray, "2 4 4"],
    pixel: Float[np.ndarray, "2"],
    box: Box,
) -> Float[np.ndarray, "2 2"] | None:
    """Cut the ray through a pixel of the first image to a box of the second, from near to far.

    Pinholes without distortion; the first pixel's centre is (0.5, 0.5). Only what lies before both cameras counts; None
    where nothing of that is in the box. Hartley and Zisserman 2004, 9.1: the ray's image joins the epipole to its
    vanishing point. On it every bound of the box is linear in homogeneous coordinates (Liang and Barsky 1984).
    """
    (first, second), (near_pose, far_pose) = np.asarray(intrinsics, float), np.asarray(cam_from_world, float)
    direction = near_pose[:3, :3].T @ np.linalg.solve(first, [*np.asarray(pixel, float), 1.0])
    centre = -near_pose[:3, :3].T @ near_pose[:3, 3]
    epipole = second @ (far_pose[:3, :3] @ centre + far_pose[:3, 3])
    vanishing = second @ far_pose[:3, :3] @ direction
    left, top, right, bottom = box
    bounds = np.array(
        [[1, 0, -left], [-1, 0, right], [0, 1, -top], [0, -1, bottom], [0, 0, 1]]
    )  # what is not negative times the homogeneous point is within
    start, end = bounds @ epipole, bounds @ vanishing
    start[4] -= _NEAREST
    low, high = 0.0, 1.0
    for a, b in zip(start, end, strict=True):
        if a < 0 and b < 0:
            return None
        if a * b < 0:
            low, high = (max(low, a / (a - b)), high) if a < 0 else (low, min(high, a / (a - b)))
    if low >= high:
        return None
    ends = [(1 - share) * epipole + share * vanishing for share in (low, high)]
    return np.array([point[:2] / point[2] for point in ends if point[2] > 0]) if ends[1][2] > 0 else None


class EpipolarGeometry:
    """Lines of the recorded videos of calibrated cameras, which a lens may bend.

    cameras: of the videos as recorded (`Capture.as_recorded`).
    """

    def __init__(self, cameras: Cameras):
        self._intrinsics = np.asarray(cameras.intrinsics, float)
        self._poses = np.asarray(cameras.cam_from_world, float)
        self._lenses = [
            Undistortion(k, d, size) if d.any() else None
            for k, d, size in zip(self._intrinsics, np.asarray(cameras.distortion, float), cameras.sizes, strict=True)
        ]
        self._boxes = [_box(lens, size) for lens, size in zip(self._lenses, cameras.sizes, strict=True)]

    def line(
        self, frame: int, source: int, target: int, pixel: Float[np.ndarray, "2"]
    ) -> Float[np.ndarray, "vertex 2"] | None:
        """Draw where what is seen at a pixel of the `source` camera may lie in the `target` camera's picture.

        The line is given by vertices in the video's pixels, from near to far; None where all of it is out of the
        picture.
        """
        lens, pair = self._lenses[source], np.array([source, target])
        if lens is not None:
            pixel = lens.points(np.asarray(pixel, float)[None])[0]
        segment = epipolar_segment(self._intrinsics[pair], self._poses[pair, frame], pixel, self._boxes[target])
        lens = self._lenses[target]
        if segment is None or lens is None:
            return segment
        return lens.recorded_points(np.linspace(segment[0], segment[1], _SAMPLES))


def _box(lens: Undistortion | None, size: tuple[int, int]) -> Box:
    """Find what part of the undistorted image the recorded picture covers."""
    width, height = size
    if lens is None:
        return 0.0, 0.0, float(width), float(height)
    share = np.linspace(0, 1, _SAMPLES)[:, None]
    corners = np.array([[0, 0], [width, 0], [width, height], [0, height], [0, 0]], float)
    border = np.concatenate([a + share * (b - a) for a, b in pairwise(corners)])
    ideal = lens.points(border)
    ideal = ideal[np.isfinite(ideal).all(1)]
    (left, top), (right, bottom) = ideal.min(0), ideal.max(0)
    return float(left), float(top), float(right), float(bottom)
