"""Mask images, by camera and frame."""

from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Bool

from jaxmocap._results import InputError


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
