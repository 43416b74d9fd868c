"""The sound of videos, the delay between two tracks, and the drift of their clocks."""

from dataclasses import dataclass
from itertools import pairwise

import av
import numpy as np
from jaxtyping import Float32, Float64

from .._video import VideoIndex
from ._estimate import Estimate, Undecided
from ._phase_correlation import RATE, match_anywhere, phase_correlation, repetition, smear

_LONGEST = 1800.0  # seconds
_SILENCE = 1e-4  # of full scale, root mean square
_SHORTEST = 0.5  # seconds
_LEAST_SHARED = 1.0  # seconds
_GUARD = 0.05  # seconds; echoes that are closer than this belong to the peak
_SHARP = 0.3
_PERIODIC = 0.9
_WINDOW = 5.0  # seconds
_FEWEST_WINDOWS = 6
_MOST_WINDOWS = 40
_ENOUGH = 4  # windows
_LONG = 20.0  # seconds from which on a drift is measured
_NEAR = 0.003  # seconds
_CLEAR = 6.0  # deviations of the noise


@dataclass(frozen=True, eq=False)
class Sound:
    """Mono samples at `RATE` per second; the first is heard at `start`, in seconds since the video's first frame."""

    name: str
    samples: Float32[np.ndarray, " sample"]
    start: float

    def between(self, start: float, stop: float) -> "Sound":
        """Take what is heard from one second to another. Raises `Undecided` where that is too little."""
        first, end = ((np.clip(at - self.start, 0, len(self.samples) / RATE) * RATE) for at in (start, stop))
        samples = self.samples[round(float(first)) : round(float(end))]
        if len(samples) < _SHORTEST * RATE:
            raise Undecided(f"{self.name} has only {len(samples) / RATE:.2f} s of sound in the frames that count")
        return Sound(self.name, samples, self.start + round(float(first)) / RATE)


def read_sound(index: VideoIndex) -> Sound:
    """Read the first sound track of a video, at most half an hour; gaps between its timestamps become silence.

    Raises `Undecided` if there is none, none that can be heard, or none that can be decoded.
    """
    name = index.path.name
    pieces: list[tuple[float, np.ndarray]] = []  # seconds of the first sample, samples
    try:
        with av.open(str(index.path), metadata_errors="replace") as container:
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


def compare_sounds(first: Sound, second: Sound) -> Estimate:
    """Measure the delay between two tracks, and over long clips the drift of their clocks.

    Where 20 s or more are shared, a line is laid through the delays of windows along the clip; its slope, the drift,
    is the median of slopes (Theil and Sen). The confidence is the sharpness, 1 less the height of the next best peak
    relative to the best, times the share that fits of four windows: one clap alone may be another's. Raises
    `Undecided` if no delay stands out. Sound needs 3 ms per metre: the offset is as wrong as the distances of the
    cameras to what was heard differ.
    """
    a, b = first.samples, second.samples
    lags = np.arange(1 - len(b), len(a))
    shared = np.minimum(len(a), len(b) + lags) - np.maximum(lags, 0)
    lags = lags[shared >= _LEAST_SHARED * RATE]
    if not lags.size:
        raise Undecided(f"{first.name} and {second.name} have less than {_LEAST_SHARED:g} s of sound")
    for sound in (first, second):
        likeness, period = repetition(sound.samples, _GUARD)
        if likeness > _PERIODIC:
            raise Undecided(f"the sound of {sound.name} repeats itself after {period:.2f} s")
    power = match_anywhere(a, b, lags)
    peak, sharpness = _highest(power, int(_GUARD * RATE) + smear(len(a), len(b)))
    if sharpness < _SHARP:
        raise Undecided(
            f"the sound of {first.name} fits that of {second.name} nowhere better than elsewhere (sharpness "
            f"{sharpness:.2f}; {_SHARP} is needed)"
        )
    lag = int(lags[peak])
    begin, end = max(0, -lag), min(len(b), len(a) - lag)
    line, windows = _fit_line(a, b, lag, begin, end)
    if not line.matched:
        raise Undecided(f"the sound of {first.name} fits that of {second.name} as a whole, but at no single moment")
    return Estimate(
        "sound",
        offset=first.start - second.start + line.delay,
        confidence=sharpness * min(line.matched / _ENOUGH, 1.0),
        when=second.start + (begin + end) / (2 * RATE),
        drift=line.drift,
        detail={
            "shared_seconds": round((end - begin) / RATE, 3),
            "sharpness": round(sharpness, 4),
            "windows": windows,
            "windows_matched": line.matched,
            "spread_seconds": round(line.spread, 6),
            "drift_ppm": None if line.drift is None else round(1e6 * line.drift, 3),
        },
    )


def _highest(power: Float64[np.ndarray, " lag"], guard: int) -> tuple[int, float]:
    """Place of the highest peak (the middle of a flat one), and 1 - (next best / best) in amplitude above the usual
    level."""
    peak = int(np.mean(np.flatnonzero(power >= 0.999 * power.max())))
    level = float(np.median(power))
    others = np.concatenate([power[: max(peak - guard, 0)], power[peak + guard + 1 :]])
    rival = max(float(others.max()) - level, 0.0) if others.size else 0.0
    height = float(power.max()) - level
    return peak, max(1.0 - float(np.sqrt(rival / height)), 0.0) if height > 0 else 0.0


@dataclass(frozen=True)
class _Line:
    """Delay in seconds in the middle, seconds by which windows are off in the median, and windows that fit."""

    delay: float
    drift: float | None
    spread: float
    matched: int


def _fit_line(
    a: Float32[np.ndarray, " of_a"], b: Float32[np.ndarray, " of_b"], lag: int, begin: int, end: int
) -> tuple[_Line, int]:
    """Fit the line through the delays of windows from `begin` to `end` of `b`; count the windows.

    Its slope is known where enough windows of a long span have a clear peak near `lag`; else its height is that of all
    at once.
    """
    count = int(np.clip((end - begin) / (_WINDOW * RATE), _FEWEST_WINDOWS, _MOST_WINDOWS))
    times, delays = [], []
    for left, right in pairwise(np.linspace(begin, end, count + 1).astype(int)):
        peak, clear = _peak_near(a, b, lag, left, right)
        if clear:
            times.append((left + right) / (2 * RATE))
            delays.append(peak / RATE)
    slope, delay, middle = None, _peak_near(a, b, lag, begin, end)[0] / RATE, (begin + end) / (2 * RATE)
    if len(times) >= _ENOUGH and end - begin >= _LONG * RATE:
        from scipy.stats import theilslopes  # takes a second to import

        slope = float(theilslopes(delays, times).slope)  # pyright: ignore
        delay = float(np.median(np.asarray(delays) - slope * (np.asarray(times) - middle)))
    off = np.abs(np.asarray(delays) - (slope or 0.0) * (np.asarray(times) - middle) - delay)
    spread = float(1.4826 * np.median(off)) if times else 0.0
    return _Line(delay, slope, spread, int(np.sum(off < _NEAR))), count


def _peak_near(
    a: Float32[np.ndarray, " of_a"], b: Float32[np.ndarray, " of_b"], lag: int, left: int, right: int
) -> tuple[int, bool]:
    """Find the lag near `lag` at which samples `left` to `right` of `b` fit best, and whether it stands out."""
    reach = smear(len(a), len(b)) + int(0.02 * RATE)
    around = np.arange(lag - reach, lag + reach + 1)
    start = max(left + lag - reach, 0)
    correlation = phase_correlation(a[start : max(right + lag + reach, 0)], b[left:right])
    values = np.abs(correlation[(around - (start - left)) % len(correlation)])
    best = int(np.argmax(values))
    return int(around[best]), bool(values[best] > _CLEAR * 1.4826 * np.median(np.abs(correlation)))
