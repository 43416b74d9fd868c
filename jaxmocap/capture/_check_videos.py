"""Checks of videos: whether every frame can be decoded and shows something, and whether times are what they should."""

from collections.abc import Iterator, Sequence

import numpy as np

from jaxmocap._results import InputError
from jaxmocap.camera import ranges

from ._config import CaptureConfig
from ._findings import Finding
from ._video import FrameReader, VideoIndex

_MOST_DECODED = 600
_BLACK = 6.0  # mean of 255
_FPS_TOLERANCE = 0.02
_STEADY_INTERVAL = 0.1


def _sample(count: int) -> np.ndarray:
    """All frames of a short video; beginning, middle and end of a long one."""
    if count <= _MOST_DECODED:
        return np.arange(count)
    third = _MOST_DECODED // 3
    middle = (count - third) // 2
    return np.concatenate([np.arange(third), np.arange(middle, middle + third), np.arange(count - third, count)])


def _pictures(camera: str, index: VideoIndex) -> Iterator[Finding]:
    reader = FrameReader(index)
    dark, damaged, decoded = [], [], 0
    try:
        for frame in _sample(index.num_frames):
            picture = reader.read(int(frame))[::8, ::8]
            decoded += 1
            if picture.mean() < _BLACK:
                dark.append(int(frame))
            if reader.corrupt:
                damaged.append(int(frame))
    except InputError as error:
        yield Finding("error", f"{camera} frame {int(frame)}", str(error))
    finally:
        reader.close()
    if decoded and len(dark) == decoded:
        yield Finding("error", camera, f"video {index.path} is black in all {decoded} decoded frames")
    elif dark:
        yield Finding(
            "warning", f"{camera} frames {ranges(dark)}", f"video {index.path} is black in frames {ranges(dark)}"
        )
    if damaged:
        message = f"video {index.path} is damaged in frames {ranges(damaged)}, where the decoder had to guess"
        yield Finding("warning", f"{camera} frames {ranges(damaged)}", message)


def _times(camera: str, index: VideoIndex, nominal: float | None) -> Iterator[Finding]:
    if index.num_frames < 2:
        return
    measured = (index.num_frames - 1) / index.seconds[-1]
    if nominal is not None and abs(measured / nominal - 1) > _FPS_TOLERANCE:
        yield Finding(
            "warning",
            camera,
            f"capture.toml says fps = {nominal:g}, but the timestamps of {index.path.name} give {measured:.2f} frames "
            "per second; the timestamps are used",
        )
    steps = np.diff(index.seconds)
    if np.abs(steps - index.interval).max() > _STEADY_INTERVAL * index.interval:
        yield Finding(
            "note",
            camera,
            f"{index.path.name} has a variable frame rate, {1000 * steps.min():.1f} to {1000 * steps.max():.1f} ms "
            "between frames; each frame's own timestamp is used",
        )


def check_videos(config: CaptureConfig, indices: Sequence[VideoIndex | None]) -> Iterator[Finding]:
    """Everything about the videos that could be indexed (the others are None)."""
    readable = [(entry, index) for entry, index in zip(config.camera, indices, strict=True) if index is not None]
    for entry, index in readable:
        yield from _times(entry.name, index, config.fps)
        yield from _pictures(entry.name, index)
    counts = {index.num_frames for _, index in readable}
    if len(counts) > 1 and max(counts) - min(counts) > 1 and not any(entry.offset for entry in config.camera):
        listed = ", ".join(f"{index.path.name} {index.num_frames} ({index.seconds[-1]:.2f} s)" for _, index in readable)
        yield Finding(
            "warning",
            "videos",
            f"the videos have different numbers of frames: {listed}; they are taken to start at the same moment: if "
            "they do not, run jaxmocap sync",
        )
