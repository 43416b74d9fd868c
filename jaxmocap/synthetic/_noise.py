"""Seeded periodic noise in two and three dimensions, the grain of every synthetic surface."""

import cv2
import numpy as np
from jaxtyping import Float
from scipy import ndimage

_LATTICE = 24
_FINE = 4


def noise_volume(rng: np.random.Generator) -> Float[np.ndarray, "n n n"]:
    """Smooth noise with period 24 lattice cells and features about one cell wide, mean 0, standard deviation 1."""
    coarse = rng.standard_normal((_LATTICE,) * 3)
    at = np.arange(_LATTICE * _FINE) / _FINE
    for axis in range(3):
        coarse = _interpolate(coarse, at, axis)
    return ((coarse - coarse.mean()) / coarse.std()).astype(np.float32)


def _interpolate(values: np.ndarray, at: np.ndarray, axis: int) -> np.ndarray:
    """Periodic quintic-smoothed interpolation along one axis."""
    low = np.floor(at).astype(int)
    t = at - low
    t = t**3 * (t * (6 * t - 15) + 10)
    shape = [1] * values.ndim
    shape[axis] = -1
    t = t.reshape(shape)
    n = values.shape[axis]
    return (1 - t) * np.take(values, low % n, axis) + t * np.take(values, (low + 1) % n, axis)


def sample_noise(
    volume: Float[np.ndarray, "n n n"], points: Float[np.ndarray, "point 3"], size: float
) -> Float[np.ndarray, "point"]:
    """Noise at points, its features `size` metres wide."""
    at = (points.T * np.float32(_FINE / size)).astype(np.float32)
    return ndimage.map_coordinates(volume, at, order=1, mode="grid-wrap", output=np.float32)


def noise_image(
    rng: np.random.Generator, shape: tuple[int, int], cells: tuple[float, float], octaves: int = 1
) -> Float[np.ndarray, "height width"]:
    """Smooth noise image: about `cells` features down and across in the first octave, each further octave at half the
    size and half the strength; mean 0, standard deviation 1."""
    total = np.zeros(shape, np.float32)
    for octave in range(octaves):
        lattice = rng.standard_normal([max(2, round(c * 2**octave)) for c in cells], dtype=np.float32)
        layer = cv2.resize(lattice, shape[::-1], interpolation=cv2.INTER_CUBIC)
        total += np.float32(0.5**octave) * layer
    return (total - total.mean()) / total.std()
