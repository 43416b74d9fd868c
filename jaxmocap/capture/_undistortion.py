"""Removing lens distortion from images, masks and points of one camera, keeping its K."""

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8


class Undistortion:
    """OpenCV's five-coefficient model (k1 k2 p1 p2 k3), with `K` whose first pixel centre is at (0.5, 0.5).

    OpenCV counts from the centre of the first pixel, so half a pixel is taken off before and added after it.
    """

    def __init__(
        self, intrinsics: Float[np.ndarray, "3 3"], distortion: Float[np.ndarray, " 5"], size: tuple[int, int]
    ):
        self._matrix = np.asarray(intrinsics, float).copy()
        self._matrix[:2, 2] -= 0.5
        self._distortion = np.asarray(distortion, float)
        self._maps = cv2.initUndistortRectifyMap(
            self._matrix, self._distortion, np.eye(3), self._matrix, size, cv2.CV_32FC1
        )

    def image(self, image: UInt8[np.ndarray, "height width 3"]) -> UInt8[np.ndarray, "height width 3"]:
        """Bilinear. Where the lens saw nothing, the nearest pixel is repeated, so that no false edge appears."""
        return cv2.remap(image, *self._maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)

    def mask(self, mask: Bool[np.ndarray, "height width"]) -> Bool[np.ndarray, "height width"]:
        """Nearest pixel; False where the lens saw nothing."""
        return cv2.remap(mask.astype(np.uint8), *self._maps, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT) > 0

    def recorded_mask(self, mask: Bool[np.ndarray, "height width"]) -> Bool[np.ndarray, "height width"]:
        """The inverse of `mask`: an undistorted mask in the recorded video."""
        height, width = mask.shape
        rows, columns = np.mgrid[:height, :width]
        ideal = self.points(np.stack([columns, rows], -1).reshape(-1, 2) + 0.5) - 0.5
        maps = ideal.reshape(height, width, 2).astype(np.float32)
        return cv2.remap(mask.astype(np.uint8), maps, None, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT) > 0  # pyright: ignore

    def points(self, points: Float[np.ndarray, "point 2"]) -> Float[np.ndarray, "point 2"]:
        """Pixels of the recorded video -> pixels of the undistorted image."""
        raw = (np.asarray(points, float) - 0.5).reshape(-1, 1, 2)
        criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-9)
        ideal = cv2.undistortPoints(raw, self._matrix, self._distortion, R=np.eye(3), P=self._matrix, criteria=criteria)
        return ideal.reshape(-1, 2) + 0.5
