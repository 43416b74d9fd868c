"""Features of video frames away from the person (SIFT, Lowe 2004), and matches between two frames."""

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float32, UInt8, UInt32

from jaxmocap.capture import FrameReader, index_video, read_mask

from ._footage import VideoFootage

_CONTRAST = 0.015  # below OpenCV's 0.04: a lawn or a plastered wall has little
_BLUR = 1.25  # pixels, against the sensor's noise: of a noisy video two to three times as many features match
_RATIO = 0.8
_MASK_MARGIN = 15  # pixels at a width of 960
_BOX_REACH = 5  # frames for which a box of another frame still tells where the person is
_BOX_GROWTH = 0.02  # of the box's size per frame between


class Features(NamedTuple):
    """Features of one frame.

    Attributes:
        points: in pixels, the centre of the first pixel at (0.5, 0.5).
        descriptors: square roots of SIFT's, times 512 (Arandjelovic and Zisserman, CVPR 2012).
    """

    points: Float32[np.ndarray, "feature 2"]
    descriptors: UInt8[np.ndarray, "feature 128"]


def person_mask(video: VideoFootage, frame: int) -> Bool[np.ndarray, "height width"]:
    """Mark where the person may be, with a margin: a mask of this very frame, else the nearest box within five frames.

    False everywhere if neither is known: then only robust estimation keeps the person out.
    """
    width, height = video.size
    if frame in video.masks:
        margin = 2 * round(_MASK_MARGIN * max(width, height) / 960) + 1
        mask = read_mask(Path(video.masks[frame]), video.recorded_size or video.size).astype(np.uint8)
        mask = cv2.resize(mask, video.size, interpolation=cv2.INTER_NEAREST)
        return cv2.dilate(mask, np.ones((margin, margin), np.uint8)) > 0
    covered = np.zeros((height, width), bool)
    near = min(video.boxes, key=lambda other: abs(other - frame), default=None)
    if near is not None and abs(near - frame) <= _BOX_REACH:
        left, top, right, bottom = video.boxes[near]
        grow = 0.1 + _BOX_GROWTH * abs(near - frame)
        across, down = grow * (right - left), grow * (bottom - top)
        rows = slice(max(int(top - down), 0), max(int(bottom + down), 0))
        covered[rows, max(int(left - across), 0) : max(int(right + across), 0)] = True
    return covered


def detect(
    image: UInt8[np.ndarray, "height width 3"], person: Bool[np.ndarray, "height width"], count: int
) -> Features:
    """Find at most `count` features, those of the strongest contrast, outside the person."""
    detector = cv2.SIFT_create(  # pyright: ignore[reportAttributeAccessIssue]
        nfeatures=count, contrastThreshold=_CONTRAST, enable_precise_upscale=True
    )
    grey = cv2.GaussianBlur(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), (0, 0), _BLUR)
    found, raw = detector.detectAndCompute(grey, np.where(person, 0, 255).astype(np.uint8))
    if not found or raw is None:
        return Features(np.zeros((0, 2), np.float32), np.zeros((0, 128), np.uint8))
    places = np.array([point.pt for point in found], np.float32) + 0.5
    places, first = np.unique(places, axis=0, return_index=True)  # one of a place's several orientations
    raw = raw[first]
    roots = np.sqrt(raw / np.maximum(raw.sum(1, keepdims=True), 1e-6))
    return Features(places, np.minimum(np.round(512 * roots), 255).astype(np.uint8))


def read_images(
    video: VideoFootage, frames: Iterable[int]
) -> Iterator[tuple[int, UInt8[np.ndarray, "height width 3"]]]:
    """Decode the frames, in order, made as large as the footage says."""
    reader = FrameReader(index_video(Path(video.path)))
    try:
        for frame in frames:
            image = reader.read(frame)
            if video.recorded_size is not None:
                image = cv2.resize(image, video.size, interpolation=cv2.INTER_AREA)
            yield frame, image
    finally:
        reader.close()


def read_features(video: VideoFootage, frames: Iterable[int], count: int) -> Iterator[tuple[int, Features]]:
    """Decode the frames, in order, and find their features."""
    for frame, image in read_images(video, frames):
        yield frame, detect(image, person_mask(video, frame), count)


def match(a: Features, b: Features) -> UInt32[np.ndarray, "match 2"]:
    """Match features that choose each other and pass Lowe's ratio test in both directions: rows of `a` and of `b`."""
    if min(len(a.points), len(b.points)) < 2:
        return np.zeros((0, 2), np.uint32)
    cosines = _unit(a) @ _unit(b).T
    chosen = cosines.argmax(1)
    best = cosines.max(1)
    rows = np.flatnonzero(best == cosines.max(0)[chosen])
    columns, best = chosen[rows], best[rows]
    cosines[rows, columns] = -1.0
    second = np.maximum(cosines.max(1)[rows], cosines.max(0)[columns])
    good = 1 - np.minimum(best, 1.0) < _RATIO**2 * (1 - np.minimum(second, 1.0))  # squared distances, halved
    return np.stack([rows[good], columns[good]], 1).astype(np.uint32)


def _unit(features: Features) -> Float32[np.ndarray, "feature 128"]:
    values = features.descriptors.astype(np.float32)
    return values / np.maximum(np.linalg.norm(values, axis=1, keepdims=True), 1e-6)
