"""From recorded videos and mask files to the pictures that are worked on: made smaller, lens distortion removed, and
turned where a camera was held the other way than the others."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from jaxmocap._results import InputError


def reduced_size(size: tuple[int, int], longest_side: int | None) -> tuple[int, int]:
    """Reduce (width, height) in proportion until no side is longer, both even as videos must be.

    It stays as it is where it is small enough, or for None.
    """
    if longest_side is None or max(size) <= longest_side:
        return size
    width, height = (max(2 * round(side * longest_side / max(size) / 2), 2) for side in size)
    return width, height


def turns(sizes: Sequence[tuple[int, int]]) -> tuple[bool, ...]:
    """Say which pictures to turn by a quarter so that what all (width, height) have in common is largest.

    None are turned where that gains nothing, as where all cameras were held the same way.
    """
    lying = np.array([width > height for width, height in sizes])
    choices = (np.zeros_like(lying), ~lying, lying)

    def common(turned: Bool[np.ndarray, "camera"]) -> int:
        shown = np.where(turned[:, None], np.fliplr(sizes), sizes)
        return int(shown.min(axis=0).prod())

    return tuple(bool(turn) for turn in max(choices, key=common))


class Turn:
    """A quarter turn to the left, of pictures `width` pixels wide."""

    def __init__(self, width: int):
        self._width = width

    def image(self, image: UInt8[np.ndarray, "height width 3"]) -> UInt8[np.ndarray, "width height 3"]:
        """Turn an image: its right edge becomes the upper one."""
        return np.ascontiguousarray(np.rot90(image))

    def mask(self, mask: Bool[np.ndarray, "height width"]) -> Bool[np.ndarray, "width height"]:
        """Turn a mask."""
        return np.ascontiguousarray(np.rot90(mask))

    def recorded_mask(self, mask: Bool[np.ndarray, "width height"]) -> Bool[np.ndarray, "height width"]:
        """Invert `mask`."""
        return np.ascontiguousarray(np.rot90(mask, -1))

    def points(self, points: Float[np.ndarray, "point 2"]) -> Float[np.ndarray, "point 2"]:
        """Map pixels of the picture to pixels of the turned one."""
        return np.stack([points[:, 1], self._width - points[:, 0]], axis=1)


class Reduction:
    """From the `recorded` (width, height) to a smaller one; whole pixels, so both axes have their own factor."""

    def __init__(self, recorded: tuple[int, int], size: tuple[int, int]):
        self._recorded, self._size = recorded, size
        self._factors = np.divide(size, recorded)

    def image(self, image: UInt8[np.ndarray, "height width 3"]) -> UInt8[np.ndarray, "lower narrower 3"]:
        """Average the pixels that fall into one."""
        return cv2.resize(image, self._size, interpolation=cv2.INTER_AREA)

    def mask(self, mask: Bool[np.ndarray, "height width"]) -> Bool[np.ndarray, "lower narrower"]:
        """Mark where at least half of what falls into a pixel is in the mask."""
        return cv2.resize(255 * mask.astype(np.uint8), self._size, interpolation=cv2.INTER_AREA) > 127

    def recorded_mask(self, mask: Bool[np.ndarray, "lower narrower"]) -> Bool[np.ndarray, "height width"]:
        """Invert `mask` as far as possible: larger, the outline straight between pixels."""
        return cv2.resize(255 * mask.astype(np.uint8), self._recorded, interpolation=cv2.INTER_LINEAR) > 127

    def points(self, points: Float[np.ndarray, "point 2"]) -> Float[np.ndarray, "point 2"]:
        """Map pixels of the recorded video to pixels of the smaller picture."""
        return points * self._factors


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

    def image(self, image: UInt8[np.ndarray, "height width *rgb"]) -> UInt8[np.ndarray, "height width *rgb"]:
        """Undistort an image bilinearly.

        Where the lens saw nothing, the nearest pixel is repeated, so that no false edge appears.
        """
        return cv2.remap(image, *self._maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)

    def mask(self, mask: Bool[np.ndarray, "height width"]) -> Bool[np.ndarray, "height width"]:
        """Undistort a mask by nearest pixels; False where the lens saw nothing."""
        return cv2.remap(mask.astype(np.uint8), *self._maps, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT) > 0

    def recorded_mask(self, mask: Bool[np.ndarray, "height width"]) -> Bool[np.ndarray, "height width"]:
        """Invert `mask`: an undistorted mask in the recorded video."""
        height, width = mask.shape
        rows, columns = np.mgrid[:height, :width]
        ideal = self.points(np.stack([columns, rows], -1).reshape(-1, 2) + 0.5) - 0.5
        maps = ideal.reshape(height, width, 2).astype(np.float32)
        return cv2.remap(mask.astype(np.uint8), maps, None, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT) > 0  # pyright: ignore

    def points(self, points: Float[np.ndarray, "point 2"]) -> Float[np.ndarray, "point 2"]:
        """Map pixels of the recorded video to pixels of the undistorted image."""
        raw = (np.asarray(points, float) - 0.5).reshape(-1, 1, 2)
        criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-9)
        ideal = cv2.undistortPoints(raw, self._matrix, self._distortion, R=np.eye(3), P=self._matrix, criteria=criteria)
        return ideal.reshape(-1, 2) + 0.5

    def recorded_points(self, points: Float[np.ndarray, "point 2"]) -> Float[np.ndarray, "point 2"]:
        """Map pixels of the undistorted image to pixels of the recorded video: the inverse of `points`."""
        ideal = np.column_stack([np.asarray(points, float) - 0.5, np.ones(len(points))])
        plane = ideal @ np.linalg.inv(self._matrix).T
        recorded, _ = cv2.projectPoints(plane, np.zeros(3), np.zeros(3), self._matrix, self._distortion)
        return recorded.reshape(-1, 2) + 0.5


def mask_file(folder: Path, camera: str, frame: int) -> Path:
    return folder / f"{camera}_{frame:05d}.png"


def read_mask(file: Path, size: tuple[int, int]) -> Bool[np.ndarray, "height width"]:
    """Read a mask image, true above half of its largest value. Raises `InputError` for a size unlike the video's."""
    image = cv2.imread(str(file), cv2.IMREAD_GRAYSCALE)
    if image is None:
        raise InputError(f"mask {file} cannot be read as an image")
    if image.shape[::-1] != size:
        raise InputError(
            f"mask {file} has {image.shape[1]}x{image.shape[0]} pixels, but its video has {size[0]}x{size[1]}; masks "
            "must have the size of the video"
        )
    return (image > image.max() / 2.0) & (image > 0)
