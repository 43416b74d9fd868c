"""The pictures of the report page: overlays, as small as they have to be for all of them to fit."""

import base64
import contextlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import UInt8

from jaxmocap._results import InputError
from jaxmocap.capture import Capture, FrameReader, VideoIndex, index_video
from jaxmocap.motion import Motion

from ._video import overlay_frames

_BUDGET = 6_000_000  # bytes of all pictures together; as text they are a third larger
_SIZES = ((800, 72), (640, 66), (512, 60), (400, 55))  # longest side in pixels, WebP quality
_SAMPLES = 6

Image = UInt8[np.ndarray, "height width 3"]
Source = Callable[[Sequence[int]], Iterator[Image]]
"""Overlays at increasing positions of a motion."""


@dataclass(frozen=True)
class ReportPictures:
    """Per view, data URIs of the overlays at `positions` of the motion."""

    names: tuple[str, ...]
    positions: tuple[int, ...]
    pictures: tuple[tuple[str, ...], ...]


def report_pictures(folder: Path, motion: Motion, capture: Capture | None, budget: int = _BUDGET) -> ReportPictures:
    """Take overlays from the videos in a result folder; where one is missing, draw them over the capture's images.

    The largest size is taken with which they fit into `budget` bytes; if none does, some frames are left out.

    Raises `InputError` where neither videos nor capture can be used.
    """
    names = () if motion.cameras is None else motion.cameras.names
    sources = [_source(folder / f"overlay_{name}.mp4", motion, capture, view) for view, name in enumerate(names)]
    if not sources:
        return ReportPictures((), (), ())
    sampled = np.unique(np.linspace(0, len(motion) - 1, _SAMPLES).astype(int)).tolist()
    samples = [image for source in sources for image in source(sampled)]
    for size, quality in _SIZES:
        each = np.mean([len(_encoded(image, size, quality)) for image in samples])
        if each * len(motion) * len(sources) <= budget:
            break
    every = int(np.ceil(each * len(motion) * len(sources) / budget))
    positions = tuple(range(0, len(motion), every))
    pictures = tuple(
        tuple(_data_uri(_encoded(image, size, quality)) for image in source(positions)) for source in sources
    )
    return ReportPictures(names, positions, pictures)


def _source(video: Path, motion: Motion, capture: Capture | None, view: int) -> Source:
    if video.is_file():
        with contextlib.suppress(InputError):  # it was cut short: drawn anew
            index = index_video(video)
            if index.num_frames == len(motion):
                return lambda positions: _read(index, positions)
    if capture is None:
        raise InputError(f"there is no {video.name} with {len(motion)} frames, and no capture to draw them from")

    def drawn(positions: Sequence[int]) -> Iterator[Image]:
        chosen = motion[np.asarray(positions)]
        assert chosen.cameras is not None  # one of which is the view
        return (image for _, image in overlay_frames(capture, chosen.cameras, motion.character, chosen, view))

    return drawn


def _read(index: VideoIndex, positions: Sequence[int]) -> Iterator[Image]:
    reader = FrameReader(index)
    try:
        for position in positions:
            yield reader.read(position)
    finally:
        reader.close()


def _encoded(image: Image, size: int, quality: int) -> bytes:
    scale = min(size / max(image.shape[:2]), 1.0)
    width, height = (max(round(scale * side), 1) for side in image.shape[1::-1])
    small = cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)
    return cv2.imencode(".webp", cv2.cvtColor(small, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_WEBP_QUALITY, quality])[
        1
    ].tobytes()


def _data_uri(picture: bytes) -> str:
    return f"data:image/webp;base64,{base64.b64encode(picture).decode('ascii')}"
