"""Pictures, masks and points of one camera, made smaller."""

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8


def reduced_size(size: tuple[int, int], longest_side: int | None) -> tuple[int, int]:
    """(width, height) in the same proportion with no side longer, even as videos must be; as it is where it is small
    enough, or for None."""
    if longest_side is None or max(size) <= longest_side:
        return size
    width, height = (max(2 * round(side * longest_side / max(size) / 2), 2) for side in size)
    return width, height


class Reduction:
    """From the `recorded` (width, height) to a smaller one; whole pixels, so both axes have their own factor."""

    def __init__(self, recorded: tuple[int, int], size: tuple[int, int]):
        self._recorded, self._size = recorded, size
        self._factors = np.divide(size, recorded)

    def image(self, image: UInt8[np.ndarray, "height width 3"]) -> UInt8[np.ndarray, "lower narrower 3"]:
        """The mean of the pixels that fall into one."""
        return cv2.resize(image, self._size, interpolation=cv2.INTER_AREA)

    def mask(self, mask: Bool[np.ndarray, "height width"]) -> Bool[np.ndarray, "lower narrower"]:
        """Where at least half of what falls into a pixel is in the mask."""
        return cv2.resize(255 * mask.astype(np.uint8), self._size, interpolation=cv2.INTER_AREA) > 127

    def recorded_mask(self, mask: Bool[np.ndarray, "lower narrower"]) -> Bool[np.ndarray, "height width"]:
        """The inverse of `mask` as far as there is one: larger, the outline straight between pixels."""
        return cv2.resize(255 * mask.astype(np.uint8), self._recorded, interpolation=cv2.INTER_LINEAR) > 127

    def points(self, points: Float[np.ndarray, "point 2"]) -> Float[np.ndarray, "point 2"]:
        """Pixels of the recorded video -> pixels of the smaller picture."""
        return points * self._factors
