"""The sound of a video, on the clock of its pictures."""

from dataclasses import dataclass

import av
import numpy as np
from jaxtyping import Float32

from .._video import VideoIndex
from ._estimate import Undecided

RATE = 16_000
_LONGEST = 1800.0  # seconds
_SILENCE = 1e-4  # of full scale, root mean square
_SHORTEST = 0.5  # seconds


@dataclass(frozen=True, eq=False)
class Sound:
    """Mono samples at `RATE` per second; the first is inlier at `start`, in seconds since the video's first frame."""

    name: str
    samples: Float32[np.ndarray, " sample"]
    start: float


def read_sound(index: VideoIndex) -> Sound:
    """The first sound track of a video, at most half an hour of it. Gaps between its timestamps are filled by silence.

    Raises `Undecided` if there is none, none that is inlier, or none that can be decoded.
    """
    name = index.path.name
    pieces: list[tuple[float, np.ndarray]] = []  # seconds of the first sample, samples
    try:
        with av.open(str(index.path)) as container:
            tracks = [track for track in container.streams.audio if track.codec_context is not None]
            if not tracks:
                raise Undecided(f"{name} has no sound")
            first_picture = float(index.pts[0] * container.streams.video[0].time_base)
            resampler = av.AudioResampler(format="flt", layout="mono", rate=RATE)
            for frame in container.decode(tracks[0]):
                pieces += [_timed(part) for part in resampler.resample(frame)]
                if pieces and pieces[-1][0] - pieces[0][0] > _LONGEST:
                    break
            else:
                pieces += [_timed(part) for part in resampler.resample(None)]
    except (av.FFmpegError, OSError, ValueError) as error:
        raise Undecided(f"the sound of {name} cannot be decoded ({error})") from error
    if not pieces:
        raise Undecided(f"{name} has no sound")
    samples = _join(pieces)
    if len(samples) < _SHORTEST * RATE:
        raise Undecided(f"{name} has only {len(samples) / RATE:.2f} s of sound")
    if np.sqrt(np.mean(np.square(samples, dtype=np.float64))) < _SILENCE:
        raise Undecided(f"{name} is silent")
    return Sound(name, samples, pieces[0][0] - first_picture)


def _timed(frame: av.AudioFrame) -> tuple[float, Float32[np.ndarray, " sample"]]:
    seconds = float((frame.pts or 0) * (frame.time_base or 0))
    return seconds, np.nan_to_num(frame.to_ndarray().reshape(-1).astype(np.float32))


def _join(pieces: list[tuple[float, np.ndarray]]) -> Float32[np.ndarray, " sample"]:
    """One track in which every piece lies at its own time; small errors of timestamps are not followed."""
    start, joined, length = pieces[0][0], [], 0
    for seconds, samples in pieces:
        gap = round((seconds - start) * RATE) - length
        if gap > 0.02 * RATE:
            joined.append(np.zeros(gap, np.float32))
            length += gap
        joined.append(samples)
        length += len(samples)
    return np.concatenate(joined)
