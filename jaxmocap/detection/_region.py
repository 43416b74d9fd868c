"""The turned square around a person that a keypoint network is shown, and the way between its pixels and the
picture's."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float32, Float64, UInt8

_ROOM = 1.25  # MediaPipe's RectTransformationCalculator of pose_detection_to_roi
_FINEST = 4


@dataclass(frozen=True)
class Region:
    """A square in a picture.

    Attributes:
        centre: x, y in pixels; the centre of the first pixel is (0.5, 0.5).
        side: pixels.
        angle: radians by which the person is turned from upright, clockwise as seen.
    """

    centre: tuple[float, float]
    side: float
    angle: float = 0.0

    @staticmethod
    def around(hips: Float64[np.ndarray, "2"], rim: Float64[np.ndarray, "2"]) -> "Region":
        """Place the region of a person whose whole body lies in a circle about the middle of the hips.

        The circle goes through `rim`, the point towards the head (Bazarevsky et al. 2020, Sec. 2.1).
        """
        across, down = rim - hips
        return Region(
            (float(hips[0]), float(hips[1])),
            max(2 * _ROOM * float(np.hypot(across, down)), 1.0),
            float(np.arctan2(across, -down)),
        )

    def holds(self, x: float, y: float) -> bool:
        """Tell whether a point of the picture lies in the square."""
        return bool(np.abs(self._axes().T @ (np.array([x, y]) - self.centre)).max() <= self.side / 2)

    def to_picture(self, points: Float64[np.ndarray, "point 2"]) -> Float64[np.ndarray, "point 2"]:
        """Map points given as shares (0 to 1) of the square's sides to pixels of the picture."""
        return (points - 0.5) * self.side @ self._axes().T + self.centre

    def cut(self, picture: UInt8[np.ndarray, "height width 3"], size: int) -> UInt8[np.ndarray, "size size 3"]:
        """Cut out what the square shows, upright, `size` pixels wide; black outside the picture."""
        finer = int(np.clip(np.ceil(self.side / size - 0.25), 1, _FINEST))  # so that no pixel is passed over
        count = size * finer
        step = self._axes() * self.side / count
        start = self.to_picture(np.zeros((1, 2)))[0] + step @ [0.5, 0.5] - 0.5
        matrix = np.column_stack([step, start])
        found = cv2.warpAffine(picture, matrix, (count, count), flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)
        return found if finer == 1 else cv2.resize(found, (size, size), interpolation=cv2.INTER_AREA)

    def paste(
        self, square: Float32[np.ndarray, "size size"], shape: tuple[int, int], outside: float
    ) -> Float32[np.ndarray, "height width"]:
        """Put values of the square's pixels into a picture of `shape` (height, width): the way back of `cut`."""
        step = self._axes() * self.side / len(square)
        start = self.to_picture(np.zeros((1, 2)))[0] + step @ [0.5, 0.5] - 0.5
        matrix = np.column_stack([step, start])
        return cv2.warpAffine(square, matrix, shape[::-1], flags=cv2.INTER_LINEAR, borderValue=outside)

    def _axes(self) -> Float64[np.ndarray, "2 2"]:
        """Return the square's own x and y in the picture, as columns."""
        sine, cosine = np.sin(self.angle), np.cos(self.angle)
        return np.array([[cosine, -sine], [sine, cosine]])


def whole(picture: UInt8[np.ndarray, "height width 3"]) -> Region:
    """Return the upright square around a whole picture."""
    height, width = picture.shape[:2]
    return Region((width / 2, height / 2), float(max(height, width)))


def brightened(picture: UInt8[np.ndarray, "height width 3"]) -> UInt8[np.ndarray, "height width 3"]:
    """Brighten a dark picture by a power law, leave a bright one as it is; black borders do not count."""
    grey = cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY)
    seen = grey[grey > 0]
    mean = float(seen.mean()) if seen.size else 255.0
    if mean >= _DARK:
        return picture
    power = np.log(_BRIGHT / 255) / np.log(max(mean, 1.0) / 255)
    levels = np.rint(255 * (np.arange(256) / 255) ** power).astype(np.uint8)
    return cv2.LUT(picture, levels[None])


_DARK, _BRIGHT = 70.0, 105.0
