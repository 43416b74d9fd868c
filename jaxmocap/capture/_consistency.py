"""Holding a capture's configuration against the files and videos that are there."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Int64

from jaxmocap._results import InputError

from ._config import CaptureConfig
from ._findings import Finding
from ._video import VideoIndex


def missing_files(file: Path, config: CaptureConfig) -> list[tuple[str, str]]:
    """Files and folders the configuration names that do not exist: (key, sentence)."""
    found = []
    for key, is_folder in (("actor", False), ("cameras", None), ("keypoints", True), ("masks", True)):
        value = getattr(config, key)
        if value is None:
            continue
        path = file.parent / value
        if not (path.exists() if is_folder is None else path.is_dir() if is_folder else path.is_file()):
            what = "folder" if is_folder else "file"
            found.append(
                (key, f"{file}: {key} = {value!r} names a {what} that does not exist; correct or remove the line")
            )
    return found


def span_of(
    config: CaptureConfig, file: Path, shared: Int64[np.ndarray, "camera frame"], indices: Sequence[VideoIndex]
) -> tuple[int, list[Finding]]:
    """How many of the shared frames to use, and what to say about it."""
    count = shared.shape[1]
    if config.frames is None or config.frames == count:
        return count, []
    videos = ", ".join(f"{index.path.name} has {index.num_frames}" for index in indices)
    if config.frames > count:
        raise InputError(
            f"{file} says frames = {config.frames}, but the videos share only {count} ({videos}); correct it, or "
            "copy the videos again if they were cut off"
        )
    return config.frames, [
        Finding(
            "warning",
            file.name,
            f"frames = {config.frames}, but the videos share {count} ({videos}); the first {config.frames} are used",
        )
    ]


def selected_positions(
    config: CaptureConfig, file: Path, first_frame: int, count: int
) -> tuple[tuple[int, ...] | None, list[Finding]]:
    if config.selected_frames is None:
        return None, []
    outside = [frame for frame in config.selected_frames if not first_frame <= frame < first_frame + count]
    if outside:
        raise InputError(
            f"{file}: selected_frames {outside} are outside the capture, which has frames {first_frame} to "
            f"{first_frame + count - 1} of the first camera"
        )
    unique = sorted(set(config.selected_frames))
    findings = []
    if len(unique) < len(config.selected_frames):
        repeated = sorted({frame for frame in unique if config.selected_frames.count(frame) > 1})
        findings.append(Finding("warning", file.name, f"selected_frames names {repeated} more than once; used once"))
    return tuple(frame - first_frame for frame in unique), findings
