"""Which frames of several videos show the same instants."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Int64

from jaxmocap._results import InputError

from ._video import VideoIndex


def shared_frames(videos: Sequence[VideoIndex], offsets: Sequence[float]) -> Int64[np.ndarray, "camera frame"]:
    """For each frame of the first video that all videos cover, the nearest frame by time of each video.

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
