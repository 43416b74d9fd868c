"""Motion in the picture over time, and the offset at which two videos' motion is most alike."""

from collections.abc import Callable, Collection
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float32, Float64
from scipy.special import ndtr

from .._video import VideoIndex, luma_frames
from ._estimate import Estimate, Undecided
from ._phase_correlation import fast_length

_LONG_SIDE = 160  # pixels
_INLIER = 0.3  # pixels
_ROUNDS = 5
_FLOOR = 0.01  # picture heights per second, below which motion is noise
_FINE = 4  # samples per frame
_LEAST_SHARED = 1.0  # seconds; and of the shorter curve at least
_LEAST_SHARE = 0.4
_CHANCE = 0.01
_LEAST_MOTION = 1e-3  # picture heights per second


@dataclass(frozen=True, eq=False)
class MotionCurve:
    """How a picture's content moves between successive frames.

    Up and down are the same for all upright cameras, wherever they stand, and so is a good part of how fast.

    Attributes:
        index: the video.
        seconds: the middle between the two frames, since the video's first.
        values: mean velocity downwards, picture heights per second, and logarithm of the root mean square speed.
    """

    index: VideoIndex
    seconds: Float64[np.ndarray, " step"]
    values: Float64[np.ndarray, "step channel"]

    def between(self, start: float, stop: float) -> "MotionCurve":
        """Take what happens from one second to another."""
        inside = (self.seconds >= start) & (self.seconds < stop)
        return MotionCurve(self.index, self.seconds[inside], self.values[inside])


def measure_motion(
    index: VideoIndex, flashes: Collection[int] = (), progress: Callable[[float], None] | None = None
) -> MotionCurve:
    """Decode a video once.

    Optical flow (DIS) between small frames, less the affine motion that most of the picture follows. Around frames in
    which a flash begins, whose flow means nothing, the curve is interpolated.

    `progress` is told the seconds done. Raises `InputError` where the video cannot be decoded.
    """
    flow = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_ULTRAFAST)
    scale = _LONG_SIDE / max(index.size)
    width, height = (max(round(side * scale), 16) for side in index.size)
    seconds, values, last = [], [], None
    for frame, luma in luma_frames(index):
        upright = index.upright(luma)
        small = cv2.resize(np.ascontiguousarray(upright), (width, height), interpolation=cv2.INTER_AREA)
        if last is not None and frame > last[0]:
            step = float(index.seconds[frame] - index.seconds[last[0]])
            own = _without_camera(flow.calc(last[1], small, np.zeros((height, width, 2), np.float32))) / (height * step)
            speed = np.sqrt(np.mean(np.sum(own**2, axis=-1)))
            values.append((np.mean(own[..., 1]), np.log(speed + _FLOOR)))
            seconds.append((index.seconds[frame] + index.seconds[last[0]]) / 2)
            for flash in flashes:
                if flash - 1 <= frame <= flash + 4:
                    values[-1] = (np.nan, np.nan)
        last = frame, small
        if progress is not None:
            progress(float(index.seconds[frame]))
    curve = np.array(values, np.float64).reshape(-1, 2)
    known = np.isfinite(curve[:, 0])
    times = np.array(seconds, np.float64)
    if known.any():
        curve = np.stack([np.interp(times, times[known], channel[known]) for channel in curve.T], axis=1)
    else:
        curve = np.zeros_like(curve)
    return MotionCurve(index, times, curve)


def _without_camera(flow: Float32[np.ndarray, "height width 2"]) -> Float64[np.ndarray, "height width 2"]:
    """Flow less its dominant affine part, found by least squares, reweighted for a Cauchy residual."""
    height, width = flow.shape[:2]
    y, x = np.mgrid[:height, :width]
    design = np.stack([np.ones(height * width), x.ravel() / width - 0.5, y.ravel() / height - 0.5], axis=1)
    target = flow.reshape(-1, 2).astype(np.float64)
    weight = np.ones(len(design))
    residual = target
    for _ in range(_ROUNDS):
        weighted = design * weight[:, None]
        affine = np.linalg.solve(weighted.T @ design + 1e-9 * np.eye(3), weighted.T @ target)
        residual = target - design @ affine
        weight = 1 / (1 + np.sum(residual**2, axis=1) / _INLIER**2)
    return residual.reshape(flow.shape)


def compare_motions(first: MotionCurve, second: MotionCurve) -> Estimate:
    """Find where two motion curves correlate most: the offset, by a parabola through the peak and its neighbours.

    The confidence is 1 less the probability that unrelated curves of the same smoothness are as alike at any offset
    (Bartlett's variance of a correlation). Raises `Undecided` if that is above 0.01.
    """
    names = first.index.path.name, second.index.path.name
    step = max(first.index.interval, second.index.interval) / _FINE
    for curve in (first, second):
        if len(curve.seconds) < 2 or np.ptp(curve.seconds) < _LEAST_SHARED:
            raise Undecided(f"{curve.index.path.name} is shorter than {_LEAST_SHARED:g} s")
        if np.ptp(curve.values[:, 0]) < _LEAST_MOTION:
            raise Undecided(f"nothing moves in {curve.index.path.name}")
    a, b = (_resample(curve, step) for curve in (first, second))
    lags = np.arange(1 - len(b), len(a))
    shared = np.minimum(len(a), len(b) + lags) - np.maximum(lags, 0)
    enough = shared >= max(_LEAST_SHARED / step, _LEAST_SHARE * min(len(a), len(b)))
    correlations = np.stack([_correlation(one, other)[enough] for one, other in zip(a.T, b.T, strict=True)])
    lags, shared = lags[enough], shared[enough]
    lengths = np.array([_memory(one, other) for one, other in zip(a.T, b.T, strict=True)])
    deviation = np.sqrt((lengths[:, None] / shared).sum(axis=0)) / len(lengths)
    significance = correlations.mean(axis=0) / deviation
    best = int(np.argmax(significance))
    chance = float(min(len(lags) / lengths.mean() * ndtr(-significance[best]), 1.0))
    if chance > _CHANCE:
        raise Undecided(
            f"the motion in {names[0]} and {names[1]} is too little alike at any offset (a likeness as good comes by "
            f"chance in {100 * chance:.0f} of 100)"
        )
    lag = lags[best] + _vertex(correlations.mean(axis=0), best)
    return Estimate(
        "motion",
        offset=float(first.seconds[0] - second.seconds[0] + lag * step),
        confidence=1 - chance,
        when=float(second.seconds[0] + (max(0, -lag) + shared[best] / 2) * step),
        detail={"correlation": round(float(correlations[:, best].mean()), 4), "chance": float(f"{chance:.3g}")},
    )


def _resample(curve: MotionCurve, step: float) -> Float64[np.ndarray, "sample channel"]:
    times = np.arange(curve.seconds[0], curve.seconds[-1], step)
    return np.stack([np.interp(times, curve.seconds, channel) for channel in curve.values.T], axis=1)


def _correlation(a: Float64[np.ndarray, " of_a"], b: Float64[np.ndarray, " of_b"]) -> Float64[np.ndarray, " lag"]:
    """Pearson's correlation over what `a` and `b` share at every lag from 1 - len(b) to len(a) - 1."""
    size = fast_length(len(a) + len(b))
    a, b = (a - a.mean()) / (a.std() + 1e-12), (b - b.mean()) / (b.std() + 1e-12)
    product = np.fft.irfft(np.fft.rfft(a, size) * np.conj(np.fft.rfft(b, size)), size)
    lags = np.arange(1 - len(b), len(a))
    begin, end = np.maximum(lags, 0), np.minimum(len(a), len(b) + lags)
    count = end - begin

    def moments(x: np.ndarray, begin: np.ndarray, end: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        sums = [np.concatenate([[0.0], np.cumsum(power)]) for power in (x, x * x)]
        mean, square = ((s[end] - s[begin]) / count for s in sums)
        return mean, np.maximum(square - mean**2, 1e-9)

    mean_a, variance_a = moments(a, begin, end)
    mean_b, variance_b = moments(b, begin - lags, end - lags)
    return (product[lags] / count - mean_a * mean_b) / np.sqrt(variance_a * variance_b)


def _memory(a: Float64[np.ndarray, " of_a"], b: Float64[np.ndarray, " of_b"]) -> float:
    """Count the samples that make one in a correlation of `a` and `b`: 1 + 2 sum of autocorrelations (Bartlett)."""
    of_both = [_correlation(x, x)[len(x) :][: min(len(a), len(b)) // 2] for x in (a, b)]
    n = min(len(one) for one in of_both)
    taper = 1 - np.arange(1, n + 1) / min(len(a), len(b))
    return float(max(1 + 2 * np.sum(of_both[0][:n] * of_both[1][:n] * taper), 1.0))


def _vertex(values: Float64[np.ndarray, " lag"], peak: int) -> float:
    """Where the parabola through a peak and its neighbours is highest, relative to the peak."""
    if not 0 < peak < len(values) - 1:
        return 0.0
    left, middle, right = values[peak - 1 : peak + 2]
    bend = left - 2 * middle + right
    return float(np.clip(0.5 * (left - right) / bend, -0.5, 0.5)) if bend < 0 else 0.0
