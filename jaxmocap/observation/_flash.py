"""A frame that a flash lights, known by how much brighter or darker whole bands of the picture are than before."""

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import UInt8

BANDS = 16
"""Bands of rows, because a rolling shutter lights part of a frame, and blocks in each."""

JUMP = 0.2
"""Change of the logarithm of brightness that counts as another light; moving cameras and people stay below 0.1."""

_BLACK = 4.0


def lit_apart(
    images: Sequence[UInt8[np.ndarray, "height width 3"]], before: Sequence[UInt8[np.ndarray, "height width 3"]]
) -> bool:
    """Whether, in any view, half of the blocks of some band have become much brighter or darker."""
    return any(
        np.abs(np.median(_brightness(now) - _brightness(then), axis=1)).max() > JUMP
        for now, then in zip(images, before, strict=True)
    )


def _brightness(image: np.ndarray) -> np.ndarray:
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY).astype(np.float32)
    return np.log(cv2.resize(grey, (BANDS, BANDS), interpolation=cv2.INTER_AREA) + _BLACK)
