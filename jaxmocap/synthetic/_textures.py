"""Procedural pictures for the static scene, and the seeded noise that is the grain of every synthetic surface.

Colours are RGB in [0, 1] whose square is the reflectance.
"""

import cv2
import numpy as np
from jaxtyping import Float
from scipy import ndimage

_LATTICE = 24  # cells in a period of the noise
_FINE = 4  # samples per cell

Picture = Float[np.ndarray, "height width 3"]
Colour = tuple[float, float, float]


def noise_volume(rng: np.random.Generator) -> Float[np.ndarray, "n n n"]:
    """Draw smooth noise with period 24 cells and features about one cell wide, mean 0, standard deviation 1."""
    coarse = rng.standard_normal((_LATTICE,) * 3)
    at = np.arange(_LATTICE * _FINE) / _FINE
    for axis in range(3):
        coarse = _interpolate(coarse, at, axis)
    return ((coarse - coarse.mean()) / coarse.std()).astype(np.float32)


def _interpolate(values: np.ndarray, at: np.ndarray, axis: int) -> np.ndarray:
    """Interpolate along one axis, periodically and smoothed by a quintic."""
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
    """Sample noise at points, its features `size` metres wide."""
    at = (points.T * np.float32(_FINE / size)).astype(np.float32)
    return ndimage.map_coordinates(volume, at, order=1, mode="grid-wrap", output=np.float32)


def noise_image(
    rng: np.random.Generator, shape: tuple[int, int], cells: tuple[float, float], octaves: int = 1
) -> Float[np.ndarray, "height width"]:
    """Draw a smooth noise image, mean 0, standard deviation 1.

    It has about `cells` features down and across in the first octave; each further octave has half their size and half
    their strength.
    """
    total = np.zeros(shape, np.float32)
    for octave in range(octaves):
        lattice = rng.standard_normal([max(2, round(c * 2**octave)) for c in cells], dtype=np.float32)
        layer = cv2.resize(lattice, shape[::-1], interpolation=cv2.INTER_CUBIC)
        total += np.float32(0.5**octave) * layer
    return (total - total.mean()) / total.std()


def bricks(
    rng: np.random.Generator,
    size: tuple[float, float],
    resolution: float,
    brick: tuple[float, float],
    colour: Colour,
    joint: float = 0.012,
    spread: float = 0.07,
) -> Picture:
    """Paint a running bond of `brick` = (width, height) metres on a wall or pavement of `size` metres.

    Each brick has its own colour; `resolution` is metres per texel.
    """
    width, height = (max(8, round(s / resolution)) for s in size)
    y, x = np.mgrid[0:height, 0:width].astype(np.float32) * np.float32(resolution)
    row = np.floor(y / brick[1]).astype(int)
    shifted = x + 0.5 * brick[0] * (row % 2)
    column = np.floor(shifted / brick[0]).astype(int)
    tint = rng.normal(0, spread, (row.max() + 1, column.max() + 1, 1)) + rng.normal(
        0, 0.35 * spread, (row.max() + 1, column.max() + 1, 3)
    )
    picture = np.asarray(colour, np.float32) + tint.astype(np.float32)[row, column]
    cells = (size[1] / 0.8, size[0] / 0.8)
    picture += 0.045 * noise_image(rng, (height, width), cells, octaves=4)[..., None]
    picture += np.float32(0.03) * rng.standard_normal((height, width, 1), dtype=np.float32)
    in_joint = (np.mod(y, brick[1]) < joint) | (np.mod(shifted, brick[0]) < joint)
    mortar = np.asarray((0.62, 0.60, 0.56), np.float32) + np.float32(0.03) * rng.standard_normal(
        (height, width, 1), dtype=np.float32
    )
    picture = np.where(in_joint[..., None], 0.7 * mortar, picture)
    return np.clip(picture, 0.02, 0.98).astype(np.float32)


def add_posters(rng: np.random.Generator, picture: Picture, resolution: float, count: int) -> Picture:
    """Paint coloured posters of random shapes at eye height of a wall picture whose last row is the ground."""
    picture = picture.copy()
    height, width = picture.shape[:2]
    for _ in range(count):
        w, h = (int(rng.uniform(0.35, 0.75) / resolution), int(rng.uniform(0.45, 0.95) / resolution))
        x = int(rng.uniform(0, max(1, width - w)))
        y = int(np.clip(height - h - rng.uniform(0.6, 1.5) / resolution, 0, height - h))
        poster = np.empty((h, w, 3), np.float32)
        poster[:] = rng.uniform(0.35, 0.9, 3)
        for _ in range(12):
            centre = (int(rng.uniform(0, w)), int(rng.uniform(0, h)))
            shape = (int(rng.uniform(0.05, 0.25) * w) + 1, int(rng.uniform(0.03, 0.2) * h) + 1)
            cv2.ellipse(
                poster, centre, shape, float(rng.uniform(0, 180)), 0, 360, rng.uniform(0.05, 0.95, 3).tolist(), -1
            )
        target = picture[y : y + h, x : x + w]
        target[:] = poster[: target.shape[0], : target.shape[1]]
    return picture


def add_windows(picture: Picture, resolution: float, spacing: float) -> Picture:
    """Paint dark framed windows in a regular row near the top of a wall picture."""
    picture = picture.copy()
    width = picture.shape[1]
    across, tall, top = (round(length / resolution) for length in (0.9, 1.1, 0.5))
    frame = max(1, round(0.06 / resolution))
    for left in range(round(0.6 / resolution), width - across, round(spacing / resolution)):
        picture[top : top + tall, left : left + across] = (0.82, 0.80, 0.76)
        inner = picture[top + frame : top + tall - frame, left + frame : left + across - frame]
        inner[:] = np.linspace(0.55, 0.25, inner.shape[0], dtype=np.float32)[:, None, None] * (0.8, 0.95, 1.1)
        middle = left + across // 2
        picture[top : top + tall, middle - frame // 2 : middle + frame // 2 + 1] = (0.82, 0.80, 0.76)
    return picture


def crate(rng: np.random.Generator, size: tuple[float, float], resolution: float, colour: Colour) -> Picture:
    """Paint a box side: blotches of two colours inside a frame."""
    width, height = (max(8, round(s / resolution)) for s in size)
    cells = (size[1] / 0.12, size[0] / 0.12)
    blotch = noise_image(rng, (height, width), cells, octaves=3)
    other = np.clip(np.asarray(colour)[::-1] * 0.6 + rng.uniform(-0.15, 0.15, 3), 0.05, 0.95)
    mix = np.clip(0.5 + 1.5 * blotch, 0, 1)[..., None]
    picture = (1 - mix) * np.asarray(colour) + mix * other
    border = max(1, round(0.04 / resolution))
    framed = np.ones((height, width, 1), bool)
    framed[border:-border, border:-border] = False
    picture = np.where(framed, 0.55 * np.asarray(colour), picture)
    picture += 0.05 * noise_image(rng, (height, width), (size[1] / 0.03, size[0] / 0.03))[..., None]
    return np.clip(picture, 0.02, 0.98).astype(np.float32)


def sky(rng: np.random.Generator, shape: tuple[int, int]) -> Picture:
    """Paint a sky, blue above, pale at the horizon, with clouds."""
    down = np.linspace(0, 1, shape[0], dtype=np.float32)[:, None, None] ** 1.5
    blue = (1 - down) * np.asarray((0.42, 0.62, 0.90)) + down * np.asarray((0.86, 0.90, 0.94))
    clouds = np.clip(0.55 * noise_image(rng, shape, (5, 12), octaves=5), 0, 1)[..., None]
    return ((1 - 0.8 * clouds) * blue + 0.8 * clouds * np.asarray((0.97, 0.97, 0.98))).astype(np.float32)
