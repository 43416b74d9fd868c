"""Whether a camera stands still: features of its background that stay where they are."""

from pathlib import Path
from typing import Literal

import cv2
import numpy as np
from jaxtyping import Bool, UInt8

from jaxmocap._results import InputError
from jaxmocap.capture import FrameReader, index_video

from ._features import person_mask
from ._footage import Footage, Report, VideoFootage

_LOOKED_AT = 9  # frames of a video
_SIDE = 640  # pixels: pictures are made smaller
_LARGEST_SHIFT = 1.0  # pixels at a width of 960; a hand moves more within a second
_SHARE = 0.5  # of the features: others are people, leaves, shadows
_FEWEST = 40

Stillness = Literal["still", "moving", "unknown"]


def find_still_cameras(footage: Footage, report: Report) -> list[Stillness]:
    """Tell for every camera whether it stands still; unknown where the background has no features.

    Raises `InputError` for a camera that stands still but is moved once.
    """
    found = []
    for number, video in enumerate(footage.videos):
        report("looking for motion of the cameras", number, len(footage.videos))
        found.append(_stillness(video))
    report("looking for motion of the cameras", len(footage.videos), len(footage.videos))
    return found


def _stillness(video: VideoFootage) -> Stillness:
    chosen = np.unique(np.linspace(video.first, video.last, _LOOKED_AT).round().astype(int))
    pictures = _pictures(video, chosen)
    start, scale = pictures[0], max(pictures[0].shape) / 960
    allowed = (~person_mask(video, int(chosen[0]))).astype(np.uint8)
    allowed = cv2.resize(allowed, start.shape[::-1], interpolation=cv2.INTER_NEAREST)
    places = cv2.goodFeaturesToTrack(start, 400, 0.005, 6, mask=allowed)
    if places is None or len(places) < _FEWEST:
        return "unknown"
    same = np.array([_same_view(start, other, places, scale) for other in pictures[1:]])
    if same.sum() >= len(same) - (len(same) > 4):
        return "still"
    end = int(np.flatnonzero(same)[-1]) + 1 if same.any() else 0
    if 2 <= end < len(same) - 1 and same[:end].all():
        later = cv2.goodFeaturesToTrack(pictures[end + 1], 400, 0.005, 6)
        if later is not None and all(_same_view(pictures[end + 1], one, later, scale) for one in pictures[end + 2 :]):
            raise InputError(
                f"camera '{video.name}' stands still, but was moved between its frames {chosen[end]} and "
                f"{chosen[end + 1]}: cut all videos there, or film again without touching it"
            )
    return "moving"


def _pictures(video: VideoFootage, frames: np.ndarray) -> list[UInt8[np.ndarray, "height width"]]:
    reader = FrameReader(index_video(Path(video.path)))
    try:
        factor = min(1.0, _SIDE / max(video.size))
        size = tuple(round(factor * side) for side in video.size)
        grey = [cv2.cvtColor(reader.read(int(frame)), cv2.COLOR_RGB2GRAY) for frame in frames]
        return [np.asarray(cv2.resize(one, size, interpolation=cv2.INTER_AREA), np.uint8) for one in grey]
    finally:
        reader.close()


def _same_view(one: np.ndarray, other: np.ndarray, places: np.ndarray, scale: float) -> bool:
    """Whether most features are where they were (pyramidal Lucas-Kanade)."""
    moved, found, _ = cv2.calcOpticalFlowPyrLK(one, other, places, np.empty_like(places))
    stays: Bool[np.ndarray, " feature"] = np.linalg.norm(moved - places, axis=-1).ravel() < _LARGEST_SHIFT * scale
    return bool((stays & (found.ravel() > 0)).mean() >= _SHARE)
