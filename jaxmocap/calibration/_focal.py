"""First guesses: focal lengths by what a phone writes into its video, else what phones have, and a level camera."""

import re
from pathlib import Path

import av
import jax
import numpy as np

from jaxmocap.camera import Cameras

PHONE_FOCAL = 0.9
"""Focal length of a phone that films, as a share of the longer side of its pictures: between 0.7 and 1.2."""

_FULL_FRAME_DIAGONAL = 43.27  # millimetres
_KEY = re.compile(r"focal_?length.*35_?mm", re.IGNORECASE)
_NUMBER = re.compile(r"\s*(\d+(?:\.\d+)?)\s*(?:mm)?\s*$")


def usual_focal(path: Path, size: tuple[int, int]) -> float:
    """Guess a focal length in pixels: what the video tells of it, else that of phones."""
    return told_focal(path, size) or PHONE_FOCAL * max(size)


def told_focal(path: Path, size: tuple[int, int]) -> float | None:
    """Read a focal length in pixels from the 35 mm equivalent that some phones write into a video; None without one.

    Read are QuickTime's `com.apple.quicktime.camera.focal_length.35mm_equivalent` and Exif's `FocalLengthIn35mmFormat`
    (or `...Film`), of the file or of its video track. The search begins there; phones crop what they film.
    """
    with av.open(str(path), metadata_errors="replace") as container:
        metadata = {**container.metadata, **container.streams.video[0].metadata}
    for key, value in metadata.items():
        number = _NUMBER.match(value)
        if _KEY.search(key) and number and 8 <= float(number[1]) <= 400:
            return float(number[1]) / _FULL_FRAME_DIAGONAL * float((size[0] ** 2 + size[1] ** 2) ** 0.5)
    return None


def level_camera(name: str, size: tuple[int, int], focal: float, num_frames: int) -> Cameras:
    """Place a camera without distortion at the world's origin that looks ahead, y up: what one video alone is given."""
    intrinsics = np.array([[focal, 0, size[0] / 2], [0, focal, size[1] / 2], [0, 0, 1]], np.float32)
    pose = np.diag([1.0, -1.0, -1.0, 1.0]).astype(np.float32)
    poses = np.broadcast_to(pose, (1, num_frames, 4, 4))
    asarray = jax.numpy.asarray
    return Cameras((name,), (size,), asarray(intrinsics[None]), asarray(np.zeros((1, 5), np.float32)), asarray(poses))
