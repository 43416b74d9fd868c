"""Dense optical flow between two pictures, with its own check."""

from typing import Any

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

_PRESETS = {
    "ultrafast": cv2.DISOPTICAL_FLOW_PRESET_ULTRAFAST,
    "fast": cv2.DISOPTICAL_FLOW_PRESET_FAST,
    "medium": cv2.DISOPTICAL_FLOW_PRESET_MEDIUM,
}


def dense_flow(
    first: UInt8[np.ndarray, "height width"], second: UInt8[np.ndarray, "height width"], preset: str = "medium"
) -> Float[np.ndarray, "height width 2"]:
    """Compute DIS optical flow (Kroeger et al. 2016): `first(p)` is at `p + flow(p)` in `second`, pixels (dx, dy)."""
    pair = np.ascontiguousarray(first), np.ascontiguousarray(second)
    method: Any = cv2.DISOpticalFlow.create(_PRESETS[preset])  # its stub does not know that no flow may be given
    return method.calc(*pair, None)


def flow_agrees(
    forward: Float[np.ndarray, "height width 2"], backward: Float[np.ndarray, "height width 2"], slack: float = 0.5
) -> Bool[np.ndarray, "height width"]:
    """Check flow both ways (Sundaram, Brox, Keutzer 2010): |F + B(p + F)|^2 < 0.01 (|F|^2 + |B|^2) + slack."""
    height, width = forward.shape[:2]
    x, y = np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32)[:, None]
    there = x + forward[..., 0], y + forward[..., 1]
    returned = cv2.remap(backward, *there, cv2.INTER_LINEAR, borderValue=(1e3, 1e3))
    return squared_length(forward + returned) < 0.01 * (squared_length(forward) + squared_length(returned)) + slack


def squared_length(flow: Float[np.ndarray, "height width 2"]) -> Float[np.ndarray, "height width"]:
    """Square a flow's length, pixels^2."""
    return flow[..., 0] ** 2 + flow[..., 1] ** 2


def sample_picture(picture: np.ndarray, columns: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Sample a picture bilinearly at pixel positions; the centre of its first pixel is (0.5, 0.5)."""
    return cv2.remap(
        picture,
        (columns - 0.5).astype(np.float32),
        (rows - 0.5).astype(np.float32),
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REPLICATE,
    )
