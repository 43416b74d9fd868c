"""Checks of the footage: pictures, timestamps, and the offsets that `sync` found."""

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from jaxmocap._results import InputError
from jaxmocap.camera import ranges

from ._config import CaptureConfig, Finding
from ._video import FrameReader, VideoIndex
from .synchronisation import SURE

_MOST_DECODED = 600
_BLACK = 6.0  # mean of 255
_FPS_TOLERANCE = 0.02
_STEADY_INTERVAL = 0.1
SYNC_REPORT = "sync.json"
_BY_HAND = 0.002  # seconds: less is rounding


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
    """Check everything about the videos that could be indexed (the others are None)."""
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


def check_sync(file: Path, config: CaptureConfig) -> Iterator[Finding]:
    """Check each pair of cameras: methods, confidences, where they disagree, and offsets that nothing has measured."""
    if len(config.camera) < 2:
        return
    report = file.parent / SYNC_REPORT
    if not report.is_file():
        if not any("offset" in entry.model_fields_set for entry in config.camera):
            yield Finding(
                "note",
                "sync",
                "no camera has an offset: the videos are taken to start at the same moment; if they do not, run "
                "jaxmocap sync first",
            )
        return
    try:
        record = json.loads(report.read_text(encoding="utf-8"))
        yield from _sync_findings(record, config)
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        yield Finding(
            "warning",
            "sync",
            f"{report} is not what sync writes ({type(error).__name__}: {error}); remove it, or run jaxmocap sync "
            f"{file.parent} again",
        )


def _sync_findings(record: dict[str, Any], config: CaptureConfig) -> Iterator[Finding]:
    measured = {name: float(camera["offset_seconds"]) for name, camera in record["cameras"].items()}
    for entry in config.camera:
        if entry.name in measured and abs(measured[entry.name] - entry.offset) > _BY_HAND:
            yield Finding(
                "note",
                "sync",
                f"{entry.name} has the offset {entry.offset:g} s in capture.toml, where sync measured "
                f"{measured[entry.name]:g} s: changed since",
            )
    for note in record["notes"]:
        yield Finding("warning", "sync", str(note))
    for pair in record["pairs"]:
        yield _pair_finding(pair)


def _pair_finding(pair: dict[str, Any]) -> Finding:
    names, used, estimates = " and ".join(pair["cameras"]), pair["used"], pair["estimates"]
    if used is None:
        return Finding("note", "sync", f"{names} have nothing in common to compare them by; others tie them together")
    listed = ", ".join(
        f"{method} {one['offset_frames']:+.2f} (confidence {one['confidence']:.2f})"
        for method, one in estimates.items()
    )
    said = f"{names} are {estimates[used]['offset_frames']:+.2f} frames apart by {used}: {listed}"
    if len(estimates) == 1 and (used == "motion" or estimates[used]["confidence"] < SURE):
        return Finding(
            "warning",
            "sync",
            f"{said}; nothing else confirms it: look at a fast moment in both videos at frames that the capture pairs, "
            "correct offset in capture.toml where they differ, and flash a lamp or clap next time",
        )
    return Finding("note", "sync", said)
