"""The static surroundings of the synthetic capture: a pavement, walls, crates and posts at many depths, and a sky."""

from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import cv2
import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from ._textures import Colour, Picture, add_posters, add_windows, bricks, crate, sky

Scenery = Literal["bricks", "skin"]
SUN = np.array([0.42, 0.80, 0.43]) / np.linalg.norm([0.42, 0.80, 0.43])
AMBIENT, DIRECT = 0.48, 0.72
GROUND_SIZE = 20.0
_GROUND_TEXEL = 0.0125
ARMS = (0.83, 0.63, 0.51)
"""About what bare arms look like."""
_PAD = 2


@dataclass(frozen=True)
class Panel:
    """A textured rectangle.

    Attributes:
        corner: top left of the picture, metres.
        right: its upper edge, metres.
        down: its left edge, metres.
        pyramid: its picture at halving sizes.
        light: what Lambert's law leaves of the picture.
        takes_shadow: whether the actor's shadow falls on it; not by default.
    """

    corner: Float[np.ndarray, "3"]
    right: Float[np.ndarray, "3"]
    down: Float[np.ndarray, "3"]
    pyramid: "Pyramid"
    light: float
    takes_shadow: bool = False


@dataclass(frozen=True)
class Pyramid:
    """One picture at halving sizes.

    Attributes:
        atlas: all levels side by side, RGB, uint8.
        starts: top left corners of the levels in the atlas, (x, y).
        sizes: of the levels, (x, y).
    """

    atlas: np.ndarray
    starts: Float[np.ndarray, "level 2"]
    sizes: Float[np.ndarray, "level 2"]


@dataclass(frozen=True)
class Scene:
    """Panels in the world (metres, y up, ground at y = 0)."""

    panels: tuple[Panel, ...]


def _pyramid(picture: Picture) -> Pyramid:
    levels = [picture]
    while min(levels[-1].shape[:2]) >= 8 and len(levels) < 9:
        half = (max(1, levels[-1].shape[1] // 2), max(1, levels[-1].shape[0] // 2))
        levels.append(np.sqrt(cv2.resize(levels[-1] ** 2, half, interpolation=cv2.INTER_AREA)))
    width = levels[0].shape[1] + (levels[1].shape[1] if len(levels) > 1 else 0) + 4 * _PAD
    height = max(levels[0].shape[0], sum(level.shape[0] + 2 * _PAD for level in levels[1:])) + 2 * _PAD
    atlas = np.zeros((height, width, 3), np.uint8)
    starts, row = [], 0
    for number, level in enumerate(levels):
        padded = cv2.copyMakeBorder(level, _PAD, _PAD, _PAD, _PAD, cv2.BORDER_REPLICATE)
        left = 0 if number == 0 else levels[0].shape[1] + 2 * _PAD
        atlas[row : row + padded.shape[0], left : left + padded.shape[1]] = np.rint(255 * padded)
        starts.append((left + _PAD, row + _PAD))
        row = 0 if number == 0 else row + padded.shape[0]
    sizes = [(level.shape[1], level.shape[0]) for level in levels]
    return Pyramid(atlas, np.asarray(starts, np.float32), np.asarray(sizes, np.float32))


def _panel(
    corner: ArrayLike, right: ArrayLike, down: ArrayLike, picture: Picture, takes_shadow: bool = False, lit: bool = True
) -> Panel:
    corner, right, down = (np.asarray(v, float) for v in (corner, right, down))
    normal = np.cross(down, right)
    normal /= np.linalg.norm(normal)
    light = AMBIENT + DIRECT * max(0.0, float(normal @ SUN)) if lit else 1.0
    return Panel(corner, right, down, _pyramid(picture), light, takes_shadow)


def _box(
    rng: np.random.Generator,
    x: float,
    z: float,
    size: tuple[float, float, float],
    colour: Colour,
) -> list[Panel]:
    """Build the four sides and the top of a crate or post standing at (x, z); size is (width, height, depth)."""
    w, h, d = size
    texel = 0.012
    side = lambda length: crate(rng, (length, h), texel, colour)  # noqa: E731
    left, right, back, front = x - w / 2, x + w / 2, z - d / 2, z + d / 2
    return [
        _panel((left, h, front), (w, 0, 0), (0, -h, 0), side(w)),
        _panel((right, h, front), (0, 0, -d), (0, -h, 0), side(d)),
        _panel((left, h, back), (0, 0, d), (0, -h, 0), side(d)),
        _panel((right, h, back), (-w, 0, 0), (0, -h, 0), side(w)),
        _panel((left, h, back), (w, 0, 0), (0, 0, d), crate(rng, (w, d), texel, colour)),
    ]


def _ground(
    rng: np.random.Generator,
    boxes: list[tuple[float, float, tuple[float, float, float]]],
    colour: Colour,
) -> list[Panel]:
    """Build the pavement with the boxes' cast shadows painted in, and a coarser one out to the horizon."""
    half = GROUND_SIZE / 2
    picture = bricks(rng, (GROUND_SIZE, GROUND_SIZE), _GROUND_TEXEL, (0.42, 0.28), colour, joint=0.022)
    shade = np.zeros(picture.shape[:2], np.float32)
    for x, z, (w, h, d) in boxes:
        base = np.array([(x + i * w / 2, z + j * d / 2) for i in (-1, 1) for j in (-1, 1)])
        outline = np.concatenate([base, base - h / SUN[1] * SUN[[0, 2]]])
        hull = cv2.convexHull(((outline + half) / _GROUND_TEXEL).astype(np.float32))
        cv2.fillConvexPoly(shade, np.rint(hull).astype(np.int32), 1.0)
    shade = cv2.GaussianBlur(shade, (0, 0), 2.5)
    sunlit = AMBIENT + DIRECT * SUN[1]
    picture *= np.sqrt(1 - shade * (1 - AMBIENT / sunlit))[..., None]
    far = 8 * half
    beyond = bricks(rng, (2 * far, 2 * far), 0.12, (2.4, 1.6), (0.60, 0.55, 0.48), joint=0.12, spread=0.03)
    return [
        _panel((-half, 0.0, -half), (2 * half, 0, 0), (0, 0, 2 * half), picture, takes_shadow=True),
        _panel((-far, -0.01, -far), (2 * far, 0, 0), (0, 0, 2 * far), beyond),
    ]


@lru_cache(maxsize=2)
def make_scene(seed: int = 0, scenery: Scenery = "bricks") -> Scene:
    """Build the square the actor moves in: pavement, three walls 5 to 11 m behind or beside, crates and posts between.

    In the "skin" scenery ground and walls are bricks in the colour of the actor's arms.
    """
    rng = np.random.default_rng([seed, 1])
    boxes = [
        (1.75, -1.9, (0.62, 0.62, 0.62)),
        (-1.95, -2.9, (0.85, 0.70, 0.60)),
        (3.1, -0.7, (0.50, 0.95, 0.50)),
        (-3.3, -0.9, (0.70, 0.55, 0.90)),
        (0.55, -3.9, (1.30, 0.42, 0.42)),
        (-0.75, -3.7, (0.24, 3.60, 0.24)),
        (3.9, -3.1, (0.26, 3.40, 0.26)),
        (-4.0, -3.6, (0.22, 3.20, 0.22)),
    ]
    skin = scenery == "skin"
    panels = _ground(rng, boxes, ARMS if skin else (0.66, 0.58, 0.50))
    panels.append(_panel((-130, 62, -70), (260, 0, 0), (0, -70, 0), sky(rng, (420, 1560)), lit=False))
    wall = lambda length, height, size, colour: bricks(rng, (length, height), 0.012, size, ARMS if skin else colour)  # noqa: E731
    back = add_posters(rng, wall(6.6, 2.9, (0.40, 0.17), (0.58, 0.55, 0.60)), 0.012, 5)
    panels.append(_panel((-1.9, 2.9, -5.2), (6.6, 0, 0), (0, -2.9, 0), back))
    side = add_windows(add_posters(rng, wall(11.0, 4.2, (0.34, 0.20), (0.78, 0.62, 0.38)), 0.012, 6), 0.012, 2.0)
    panels.append(_panel((-5.2, 4.2, 1.8), (0, 0, -11.0), (0, -4.2, 0), side[:, ::-1]))
    far = add_windows(wall(9.0, 5.0, (0.30, 0.16), (0.62, 0.34, 0.28)), 0.012, 1.7)
    panels.append(_panel((4.0, 5.0, -10.5), (9.0, 0, 0), (0, -5.0, 0), far))
    for x, z, size in boxes:
        panels += _box(rng, x, z, size, tuple(rng.uniform(0.30, 0.75, 3)))
    return Scene(tuple(panels))
