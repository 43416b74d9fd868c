"""Lengths for which Fourier transforms are fast."""

from scipy.fft import next_fast_len


def fast_length(least: int) -> int:
    """A length of at least `least` with small prime factors only."""
    length: int = next_fast_len(least, real=True)  # pyright: ignore[reportAssignmentType]
    return length
