"""Generalised cross-correlation with phase transform (GCC-PHAT; Knapp and Carter, 1976) of sound tracks."""

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int64
from scipy.fft import next_fast_len
from scipy.ndimage import maximum_filter1d, uniform_filter1d

RATE = 16_000
"""Samples per second of every track."""
FASTEST_DRIFT = 2e-4
"""Seconds per second by which two clocks may differ; those of phones differ by less than half of it."""
_BAND = (300.0, 4000.0)  # hertz: voices and claps, which every phone records and every codec keeps
_WINDOW = 20.0  # seconds
_MOST_WINDOWS = 15
_HEARD_FOR_REPEATS = 60.0  # seconds


def fast_length(least: int) -> int:
    """Find a length of at least `least` with small prime factors only."""
    length: int = next_fast_len(least, real=True)  # pyright: ignore[reportAssignmentType]
    return length


def _inside_band(size: int) -> Bool[np.ndarray, " frequency"]:
    frequencies = np.arange(size // 2 + 1) * (RATE / size)
    return (frequencies >= _BAND[0]) & (frequencies <= _BAND[1])


def phase_correlation(
    a: Float32[np.ndarray, " of_a"], b: Float32[np.ndarray, " of_b"]
) -> Float32[np.ndarray, " circular_lag"]:
    """Correlate whitened spectra within the band; circular: the lag k of `a` behind `b` is at index k."""
    size = fast_length(len(a) + len(b))
    cross = np.fft.rfft(a, size) * np.conj(np.fft.rfft(b, size))
    inside, strength = _inside_band(size), np.abs(cross)
    floor = 1e-3 * float(np.mean(strength[inside])) + 1e-30
    return np.fft.irfft(cross * (inside / np.maximum(strength, floor)).astype(np.float32), size)


def match_anywhere(
    a: Float32[np.ndarray, " of_a"], b: Float32[np.ndarray, " of_b"], lags: Int64[np.ndarray, " lag"]
) -> Float64[np.ndarray, " lag"]:
    """Measure how well `b` fits into `a` at each lag: power of the correlation, summed over windows of `b`.

    A window is so short that the drift of clocks does not blur it; over all of them a peak is as wide as the drift.
    """
    length = int(min(len(b), _WINDOW * RATE))
    count = min(_MOST_WINDOWS, -(-len(b) // length))
    total = np.zeros(len(lags))
    for begin in np.linspace(0, len(b) - length, count).astype(int):
        correlation = phase_correlation(a, b[begin : begin + length])
        place = lags + begin
        met = (place > -length) & (place < len(a))
        power = np.where(met, correlation[np.where(met, place, 0)].astype(np.float64), 0.0) ** 2
        blurred = uniform_filter1d(power, 1 + int(FASTEST_DRIFT * length), mode="constant")
        total += maximum_filter1d(blurred, smear(len(a), len(b)), mode="constant") if count > 1 else blurred
    return total


def smear(of_a: int, of_b: int) -> int:
    """Count the samples by which the drift of clocks may move a lag within tracks of these lengths."""
    return 1 + 2 * int(FASTEST_DRIFT * min(of_a, of_b))


def repetition(samples: Float32[np.ndarray, " sample"], guard: float) -> tuple[float, float]:
    """Measure how much a track is like itself at another time, more than `guard` seconds later.

    Returns the highest normalised correlation within the band, and the time in seconds.
    """
    heard = samples[: int(_HEARD_FOR_REPEATS * RATE)]
    size = fast_length(2 * len(heard))
    spectrum = np.fft.rfft(heard, size) * _inside_band(size)
    banded = np.fft.irfft(spectrum, size)[: len(heard)].astype(np.float64)
    product = np.fft.irfft(np.abs(np.fft.rfft(banded, size)) ** 2, size)[: len(heard)]
    energy = np.concatenate([[0.0], np.cumsum(banded**2)])
    lags = np.arange(int(guard * RATE), len(heard) // 2)
    norms = np.sqrt(energy[len(heard) - lags] * (energy[-1] - energy[lags]))
    values = np.abs(product[lags]) / np.maximum(norms, 1e-9 * energy[-1] + 1e-30)
    best = int(np.argmax(values))
    return float(values[best]), float(lags[best] / RATE)
