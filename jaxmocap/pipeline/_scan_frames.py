"""The frames of a walk around a person that a scan looks at: spread over the lap, the sharpest of their time."""

from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import UInt8

from jaxmocap._results import InputError
from jaxmocap._types import Report
from jaxmocap.calibration import usual_focal
from jaxmocap.capture import FrameReader, VideoIndex, index_video

VIEWS = 40
"""Frames that are looked at: nine degrees from one to the next."""

LONGEST = 1600
"""Pixels of the longer side beyond which pictures are made smaller."""

_TRIES = 4
_FEWEST = 12
_DARK = 12.0  # of 255, mean of a picture
_SHARPNESS_WIDTH = 480


class WalkFrames(NamedTuple):
    """Pictures taken out of a video.

    Attributes:
        files: in the order of the video.
        guess: of their focal length, pixels.
        scale: their size as a share of the video's; focal lengths shrink with it.
    """

    files: list[Path]
    guess: float
    scale: float


def index_of_walk(video: Path) -> VideoIndex:
    """Open a video. Raises `InputError` for one that cannot be read or is too short."""
    index = index_video(video)
    if index.num_frames < _FEWEST:
        raise InputError(
            f"{video} has {index.num_frames} frames; at least {_FEWEST}, from all around the person, are needed."
        )
    return index


def frames_of_walk(
    video: Path,
    folder: Path,
    views: int = VIEWS,
    progress: Report = lambda stage, done, total: None,
) -> WalkFrames:
    """Write the sharpest frames of a video, evenly spread over it, as pictures to `folder`.

    Sharp is what has much contrast from pixel to pixel, among frames of about the same view (the variance of the
    Laplacian; Pech-Pacheco et al., ICPR 2000). Raises `InputError` for a video that is too short or too dark.
    """
    index = index_of_walk(video)
    bins = min(views, index.num_frames)
    edges = np.linspace(0, index.num_frames, bins + 1).astype(int)
    scale = min(1.0, LONGEST / max(index.size))
    files, brightness = [], []
    reader = FrameReader(index)
    try:
        for number, (first, stop) in enumerate(pairwise(edges)):
            tries = np.unique(np.linspace(first, stop - 1, _TRIES + 2).round().astype(int)[1:-1])
            pictures = [reader.read(int(frame)).copy() for frame in tries]
            best = int(np.argmax([_sharpness(picture) for picture in pictures]))
            picture = pictures[best]
            brightness.append(float(picture.mean()))
            if scale < 1:
                size = tuple(round(scale * side) for side in index.size)
                picture = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
            file = folder / f"frame{int(tries[best]):06d}.png"
            cv2.imwrite(str(file), cv2.cvtColor(picture, cv2.COLOR_RGB2BGR))
            files.append(file)
            progress("frames of the walk", number + 1, bins)
    finally:
        reader.close()
    if np.median(brightness) < _DARK:
        raise InputError(
            f"{video} is too dark: its pictures have a mean brightness of {np.median(brightness):.0f} of 255; film "
            "where there is light."
        )
    return WalkFrames(files, scale * usual_focal(video, index.size), scale)


def _sharpness(picture: UInt8[np.ndarray, "height width 3"]) -> float:
    grey = cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY)
    scale = _SHARPNESS_WIDTH / max(grey.shape)
    small = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA) if scale < 1 else grey
    return float(cv2.Laplacian(small, cv2.CV_32F).var())
