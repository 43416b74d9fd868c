"""The flash of a lamp, seen by all cameras: the paper's way (Section 3), to a part of a frame by a rolling shutter."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, UInt8

from jaxmocap._results import InputError

from .._video import FrameReader, VideoIndex, luma_frames
from ._estimate import Estimate, Undecided

_CELLS = 16
_BEFORE = 5  # frames whose median is what a frame is compared with
_NOISES = 6.0
_LEAST_JUMP = 3.0  # of 255
_SATURATED = 245.0
_BLACK = 6.0  # mean of 255, as in `check`
_STILL = 1.5  # of 255; codecs make noise
_LIT = 0.5  # share of the cells
_APART = 4  # frames
_MOST = 30  # flashes; more are a strobe, in which none can be told from the next
_MOMENT = 3.0  # seconds; what stays bright for longer is another picture or exposure
_EDGE = 0.03  # share of the lines; a smaller band is noise
READOUT = 0.75
"""Time in which a rolling shutter reads the picture, as a share of the time between frames: phones take half to all."""


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
        """Measure the share of cells suddenly brighter than in the frames before; the unsaturated ones count."""
        padded = np.concatenate([np.repeat(self.cells[:1], _BEFORE, axis=0), self.cells[:-1]])
        before = np.median(np.lib.stride_tricks.sliding_window_view(padded, _BEFORE, axis=0), axis=-1)
        noise = 1.4826 * np.median(np.abs(np.diff(self.cells, axis=0)), axis=0)
        brighter = self.cells - before > np.maximum(_NOISES * noise, _LEAST_JUMP)
        free: Bool[np.ndarray, "frame cell"] = before < _SATURATED
        share = (brighter & free).sum(axis=1) / np.maximum(free.sum(axis=1), 1)
        return np.where(free.mean(axis=1) > 0.25, share, 0.0)

    def passes(self, frame: int) -> bool:
        """Tell a light that comes in `frame` and goes again from a black beginning's end, a fade and another scene."""
        mean, seconds = self.cells.mean(axis=1), self.index.seconds
        if mean[:frame].max(initial=0.0) < _BLACK:
            return False
        end = np.searchsorted(seconds, seconds[frame] + _MOMENT, side="right")
        gained = mean[frame:end] - np.median(mean[max(frame - _BEFORE, 0) : frame])
        return bool(gained[np.argmax(gained) :].min() < 0.5 * gained.max())


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


@dataclass(frozen=True)
class Flash:
    """A sudden light.

    Attributes:
        frame: the first it falls into.
        line: share of that frame's lines that were read before it.
        seconds: when it began, since the video's first frame.
        share: of the picture that it lights.
    """

    frame: int
    line: float
    seconds: float
    share: float


def find_flashes(brightness: Brightness) -> list[Flash]:
    """Find every moment at which more than half of the picture is suddenly brighter for a short time, in order of time.

    One that may have begun in the first frame, or before it, is left out.
    """
    jumps = brightness.jumps()
    found: list[Flash] = []
    last = -_APART
    for frame in np.flatnonzero(jumps >= _LIT):
        if frame - last >= _APART and brightness.passes(int(frame)):
            share = float(jumps[frame : frame + 2].max())
            flash = _locate(brightness.index, int(frame), share)
            if flash.frame > 1 or flash.line > _EDGE:
                found.append(flash)
        last = int(frame)
        if len(found) == _MOST:
            break
    return found


def _locate(index: VideoIndex, frame: int, share: float) -> Flash:
    """Look at full size at a flash seen in `frame`, which may have begun low in the frame before."""
    reader = FrameReader(index)
    numbers = np.clip([frame - 2, frame - 1, frame, frame + 1], 0, index.num_frames - 1)
    dark, *others = (reader.read(int(number)) for number in numbers)
    reader.close()
    lines = [_first_lit_line(dark, others[number], others) for number in (0, 1)]
    first = 0 if lines[0] < 1 - _EDGE else 1
    line = min(lines[first], 1.0)
    number = int(numbers[1 + first])
    return Flash(number, line, float(index.seconds[number]) + line * READOUT * index.interval, share)


def _first_lit_line(
    dark: UInt8[np.ndarray, "height width 3"],
    picture: UInt8[np.ndarray, "height width 3"],
    around: Sequence[UInt8[np.ndarray, "height width 3"]],
) -> float:
    """Measure the share of the lines of `picture` read before the light came, 1 if none is lit.

    The lines may run along rows or columns, from either side: videos are turned. The light of a line is compared with
    the most it gets in the pictures `around`, so that dark things do not look unlit.
    """
    best = (np.inf, 1.0)
    for axis in (1, 0):
        profile = lambda image, axis=axis: image.mean(axis=(axis, 2), dtype=np.float64)  # noqa: E731
        gained = [profile(image) - profile(dark) for image in around]
        most = np.maximum(np.max(gained, axis=0), 0.0)
        lit = np.clip((profile(picture) - profile(dark)) / np.maximum(most, 1e-9), 0.0, 1.0)
        for step in (1, -1):
            best = min(best, _fit_step(lit[::step], most[::step]))
    return best[1]


def _fit_step(lit: Float[np.ndarray, " line"], weight: Float[np.ndarray, " line"]) -> tuple[float, float]:
    """Cost and place in [0, 1] of the step from 0 to 1 that is nearest to `lit` in the weighted L1 norm."""
    before = np.concatenate([[0.0], np.cumsum(weight * lit)])
    after = np.concatenate([np.cumsum((weight * (1 - lit))[::-1])[::-1], [0.0]])
    cost = (before + after) / max(weight.sum(), 1e-9)
    place = np.flatnonzero(cost <= cost.min() + 1e-9)[-1]
    return float(cost[place]), float(place / len(lit))


def compare_flashes(
    first: Brightness, second: Brightness, of_first: Sequence[Flash], of_second: Sequence[Flash]
) -> Estimate:
    """Find the offset at which most flashes of two videos coincide within half a frame.

    The confidence is the share of the picture that the flash lights, times the lead over any other offset. Raises
    `Undecided` without a flash in both videos, or if several offsets do equally well.
    """
    missing = [b.index.path.name for b, found in ((first, of_first), (second, of_second)) if not found]
    if missing:
        raise Undecided(f"{' and '.join(missing)} {'has' if len(missing) == 1 else 'have'} no flash")
    tolerance = 0.5 * max(first.index.interval, second.index.interval)
    offsets = np.array([[one.seconds - other.seconds for other in of_second] for one in of_first])
    flat = offsets.ravel()
    votes = np.array([(np.abs(offsets - offset) < tolerance).any(axis=0).sum() for offset in flat])
    best = int(np.argmax(votes))
    elsewhere = np.abs(flat - flat[best]) >= 2 * tolerance
    rival = int(votes[elsewhere].max()) if elsewhere.any() else 0
    if rival >= votes[best]:
        raise Undecided(
            f"{first.index.path.name} and {second.index.path.name} have {len(of_first)} and {len(of_second)} flashes, "
            "which fit in several ways"
        )
    matches = [
        (one, other)
        for one in of_first
        for other in of_second
        if abs(one.seconds - other.seconds - flat[best]) < tolerance
    ]
    share = np.mean([min(one.share, other.share) for one, other in matches])
    return Estimate(
        "flash",
        offset=float(np.median([one.seconds - other.seconds for one, other in matches])),
        confidence=float(share * (votes[best] - rival) / votes[best]),
        when=float(np.mean([other.seconds for _, other in matches])),
        detail={
            "frames": [[one.frame, other.frame] for one, other in matches],
            "lines": [[round(one.line, 4), round(other.line, 4)] for one, other in matches],
        },
    )
