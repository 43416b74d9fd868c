"""How bright the parts of every frame are."""

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32

from jaxmocap._results import InputError

from .._video import VideoIndex, luma_frames

_CELLS = 16
_BEFORE = 5  # frames whose median is what a frame is compared with
_NOISES = 6.0
_LEAST_JUMP = 3.0  # of 255
_SATURATED = 245.0
_BLACK = 6.0  # mean of 255, as in `check`
_STILL = 1.5  # of 255; codecs make noise


@dataclass(frozen=True, eq=False)
class Brightness:
    """Mean luma, 0 to 255, of 16 x 16 cells of every frame of a video; one that cannot be decoded is like its
    neighbour."""

    index: VideoIndex
    cells: Float32[np.ndarray, "frame cell"]

    @property
    def complaint(self) -> str | None:
        """Why nothing can be seen in this video, if so."""
        name = self.index.path.name
        if self.index.num_frames < 2:
            return f"{name} has one frame"
        if self.cells.mean(axis=1).max() < _BLACK:
            return f"{name} is black"
        if np.abs(np.diff(self.cells, axis=0)).max() < _STILL:
            return f"{name} shows the same picture all the time"
        return None

    def jumps(self) -> Float[np.ndarray, " frame"]:
        """Share of the cells that are suddenly brighter than in the frames before; the unsaturated ones count."""
        padded = np.concatenate([np.repeat(self.cells[:1], _BEFORE, axis=0), self.cells[:-1]])
        before = np.median(np.lib.stride_tricks.sliding_window_view(padded, _BEFORE, axis=0), axis=-1)
        noise = 1.4826 * np.median(np.abs(np.diff(self.cells, axis=0)), axis=0)
        brighter = self.cells - before > np.maximum(_NOISES * noise, _LEAST_JUMP)
        free: Bool[np.ndarray, "frame cell"] = before < _SATURATED
        share = (brighter & free).sum(axis=1) / np.maximum(free.sum(axis=1), 1)
        return np.where(free.mean(axis=1) > 0.25, share, 0.0)


def measure_brightness(index: VideoIndex, progress: Callable[[float], None] | None = None) -> Brightness:
    """Decode a video once; `progress` is told the seconds done. Raises `InputError` where it cannot be decoded."""
    cells = np.zeros((index.num_frames, _CELLS * _CELLS), np.float32)
    decoded = []
    for frame, luma in luma_frames(index):
        cells[frame] = cv2.resize(luma, (_CELLS, _CELLS), interpolation=cv2.INTER_AREA).astype(np.float32).ravel()
        decoded.append(frame)
        if progress is not None:
            progress(float(index.seconds[frame]))
    if not decoded:
        raise InputError(f"video {index.path} has no frame that can be decoded; copy it again")
    known = np.array(decoded)
    before = np.searchsorted(known, np.arange(index.num_frames), side="right") - 1
    return Brightness(index, cells[known[np.maximum(before, 0)]])
