"""Which frames a capture has: those that its videos share in time, how many of them are used, which are selected."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Int64

from jaxmocap._results import InputError

from ._config import CaptureConfig, Finding
from ._video import VideoIndex


def shared_frames(videos: Sequence[VideoIndex], offsets: Sequence[float]) -> Int64[np.ndarray, "camera frame"]:
    """Match, to each frame of the first video that all videos cover, the nearest frame by time of each video.

    `offsets` (seconds) added to a video's own time, which starts at its first frame, give the common time. A video
    covers an instant up to half a frame before its first and after its last frame.
    """
    times = [video.seconds + offset for video, offset in zip(videos, offsets, strict=True)]
    first = times[0]
    covered = np.ones(len(first), bool)
    for video, own in zip(videos, times, strict=True):
        slack = 0.5 * max(video.interval, videos[0].interval) + 1e-6
        covered &= (first >= own[0] - slack) & (first <= own[-1] + slack)
    if not covered.any():
        spans = ", ".join(
            f"{v.path.name} {own[0]:.3f} to {own[-1]:.3f} s" for v, own in zip(videos, times, strict=True)
        )
        raise InputError(f"the videos share no moment: {spans}; check the offsets in capture.toml")
    wanted = first[covered]
    rows = [np.flatnonzero(covered)]
    for own in times[1:]:
        after = np.clip(np.searchsorted(own, wanted), 0, len(own) - 1)
        before = np.maximum(after - 1, 0)
        rows.append(np.where(wanted - own[before] < own[after] - wanted, before, after))
    return np.stack(rows).astype(np.int64)


def span_of(
    config: CaptureConfig, file: Path, shared: Int64[np.ndarray, "camera frame"], indices: Sequence[VideoIndex]
) -> tuple[int, list[Finding]]:
    """Choose how many of the shared frames to use, and say what there is to say about it."""
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
    """Find the positions of the selected frames, None where the capture names none, and say what is odd about them."""
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
