"""Two motion curves: the offset at which they look most alike, and how likely that is by chance."""

import numpy as np
from jaxtyping import Float64
from scipy.special import ndtr

from ._estimate import Estimate, Undecided
from ._fourier import fast_length
from ._motion_curve import MotionCurve

_FINE = 4  # samples per frame
_LEAST_SHARED = 1.0  # seconds; and of the shorter curve at least
_LEAST_SHARE = 0.4
_CHANCE = 0.01
_STILL = 1e-3  # picture heights per second


def compare_motions(first: MotionCurve, second: MotionCurve) -> Estimate:
    """The offset of the highest correlation of two motion curves, by a parabola through it and its neighbours.

    The confidence is 1 less the probability that unrelated curves of the same smoothness are as alike at any offset
    (Bartlett's variance of a correlation). Raises `Undecided` if that is above 0.01.
    """
    names = first.index.path.name, second.index.path.name
    step = max(first.index.interval, second.index.interval) / _FINE
    for curve in (first, second):
        if len(curve.seconds) < 2 or np.ptp(curve.seconds) < _LEAST_SHARED:
            raise Undecided(f"{curve.index.path.name} is shorter than {_LEAST_SHARED:g} s")
        if np.ptp(curve.values[:, 0]) < _STILL:
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
    """Samples that count as one in a correlation of `a` and `b` (Bartlett): 1 + 2 sum of their autocorrelations."""
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
