"""Two sound tracks: their delay, and the drift of their clocks."""

from itertools import pairwise

import numpy as np
from jaxtyping import Float32, Float64
from scipy.stats import theilslopes

from ._estimate import Estimate, Undecided
from ._phase_correlation import match_anywhere, phase_correlation, repetition, smear
from ._sound import RATE, Sound

_LEAST_SHARED = 1.0  # seconds
_GUARD = 0.05  # seconds; echoes that are closer than this belong to the peak
_SHARP = 0.3
_PERIODIC = 0.9
_WINDOW = 5.0  # seconds
_MOST_WINDOWS = 40
_CLEAR = 8.0  # deviations of the noise


def compare_sounds(first: Sound, second: Sound) -> Estimate:
    """The delay between two tracks, and over long clips the drift of their clocks.

    The confidence is the sharpness: 1 less the height of the next best peak, relative to the best. Where 20 s or more
    are shared, windows along the clip vote, and a line through their delays is fitted by the median of slopes (Theil
    and Sen). Raises `Undecided` if no delay stands out. Sound needs 3 ms per metre: the offset is as wrong as the
    distances of the cameras to what was heard differ.
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
    fitted = _fit_line(a, b, lag, begin, end)
    offset, drift, spread, windows = (lag / RATE, None, None, 1) if fitted is None else fitted
    return Estimate(
        "sound",
        offset=first.start - second.start + offset,
        confidence=sharpness,
        when=second.start + (begin + end) / (2 * RATE),
        drift=drift,
        detail={
            "shared_seconds": round((end - begin) / RATE, 3),
            "windows": windows,
            "spread_seconds": None if spread is None else round(spread, 6),
            "drift_ppm": None if drift is None else round(1e6 * drift, 3),
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


def _fit_line(
    a: Float32[np.ndarray, " of_a"], b: Float32[np.ndarray, " of_b"], lag: int, begin: int, end: int
) -> tuple[float, float | None, float, int] | None:
    """Delay in seconds at the middle of samples `begin` to `end` of `b`, drift, spread about the line, and number of
    windows; None if no window has a clear peak. The drift is None with fewer than four."""
    count = min(_MOST_WINDOWS, max(int((end - begin) / (_WINDOW * RATE)), 1))
    reach = smear(len(a), len(b)) + int(0.02 * RATE)
    edges = np.linspace(begin, end, count + 1).astype(int)
    around = np.arange(lag - reach, lag + reach + 1)
    times, delays = [], []
    for left, right in pairwise(edges):
        start = max(left + lag - reach, 0)
        correlation = phase_correlation(a[start : max(right + lag + reach, 0)], b[left:right])
        values = np.abs(correlation[(around - (start - left)) % len(correlation)])
        best = int(np.argmax(values))
        if values[best] > _CLEAR * 1.4826 * np.median(np.abs(correlation)):
            times.append((left + right) / (2 * RATE))
            delays.append(around[best] / RATE)
    if not times:
        return None
    slope = float(theilslopes(delays, times).slope) if len(times) >= 4 else 0.0  # pyright: ignore
    middle = (begin + end) / (2 * RATE)
    at_middle = np.asarray(delays) - slope * (np.asarray(times) - middle)
    offset = float(np.median(at_middle))
    spread = float(1.4826 * np.median(np.abs(at_middle - offset)))
    return offset, slope if len(times) >= 4 else None, spread, len(times)
