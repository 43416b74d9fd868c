"""Image edges for the contour term: Canny where, Sobel which way."""

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8


def image_edges(
    image: UInt8[np.ndarray, "height width 3"], low: float = 50.0, high: float = 150.0, sigma: float = 1.0
) -> tuple[Bool[np.ndarray, "height width"], Float[np.ndarray, "height width 2"]]:
    """Find Canny edges of the blurred grey image (sec. 4.2), and the unit gradient (dx, dy) from Sobel."""
    gray = cv2.GaussianBlur(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), (0, 0), sigma)
    return cv2.Canny(gray, low, high) > 0, unit_gradient(gray)


def mask_edges(
    mask: Bool[np.ndarray, "height width"],
) -> tuple[Bool[np.ndarray, "height width"], Float[np.ndarray, "height width 2"]]:
    """Outline a person mask as edges: its outermost pixels, and the inward unit gradient of the blurred mask."""
    solid = mask.astype(np.uint8)
    outline = (solid > 0) & (cv2.erode(solid, np.ones((3, 3), np.uint8), borderValue=1) == 0)
    return outline, unit_gradient(cv2.GaussianBlur(solid.astype(np.float32), (0, 0), 2.0))


def unit_gradient(gray: np.ndarray) -> Float[np.ndarray, "height width 2"]:
    """Compute the direction of steepest ascent per pixel, (dx, dy), zero where flat."""
    across, down = cv2.Sobel(gray, cv2.CV_32F, 1, 0), cv2.Sobel(gray, cv2.CV_32F, 0, 1)
    length = np.maximum(np.sqrt(across * across + down * down), np.float32(1e-6))
    return np.stack([across / length, down / length], -1)
