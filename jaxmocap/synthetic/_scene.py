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
_NEAR = 0.05
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


@dataclass(frozen=True)
class GroundShadow:
    """The actor's shadow on the ground.

    Attributes:
        image: darkness in [0, 1]; rows run along z, columns along x.
        corner: where the image begins, (x, z), metres.
        texel: metres.
    """

    image: np.ndarray
    corner: tuple[float, float]
    texel: float


def render_scene(
    scene: Scene,
    intrinsics: Float[np.ndarray, "3 3"],
    cam_from_world: Float[np.ndarray, "4 4"],
    size: tuple[int, int],
    shadow: GroundShadow | None = None,
) -> tuple[Float[np.ndarray, "height width 3"], Float[np.ndarray, "height width"]]:
    """Draw every panel by ray-plane intersection, one ray per pixel centre: linear light and inverse depth (1/m).

    `size` is (width, height). Pictures are read at the pyramid level whose texels are as large as the ray's footprint.
    """
    width, height = size
    colour = np.empty((height * width, 3), np.float32)
    colour[:] = (0.45, 0.55, 0.75)
    nearest = np.full((height, width), 2e-4, np.float32)
    owner = np.full((height, width), -1, np.int16)
    homographies = [_homography(panel, intrinsics, cam_from_world) for panel in scene.panels]
    for number, homography in enumerate(homographies):
        if homography is not None:
            _claim(number, homography, intrinsics, nearest, owner)
    owner, depth = owner.reshape(-1), nearest.reshape(-1)
    by_owner = np.argsort(owner, kind="stable")
    bounds = np.searchsorted(owner[by_owner], np.arange(len(scene.panels) + 1))
    for number, panel in enumerate(scene.panels):
        homography, pixels = homographies[number], by_owner[bounds[number] : bounds[number + 1]]
        if homography is not None and len(pixels):
            colour[pixels] = _shade(panel, homography, pixels, width, depth[pixels], shadow)
    return colour.reshape(height, width, 3), nearest


def _homography(panel: Panel, intrinsics: np.ndarray, cam_from_world: np.ndarray) -> np.ndarray | None:
    """Map pixel (x, y, 1) to (s, t, 1) times the inverse depth (3 x 3); None where the panel is seen edge on."""
    rotation, translation = cam_from_world[:3, :3], cam_from_world[:3, 3]
    plane = np.stack([rotation @ panel.right, rotation @ panel.down, rotation @ panel.corner + translation], axis=1)
    return None if abs(np.linalg.det(plane)) < 1e-9 else np.linalg.inv(intrinsics @ plane)


def _claim(number: int, homography: np.ndarray, intrinsics: np.ndarray, nearest: np.ndarray, owner: np.ndarray) -> None:
    """Give a panel the pixels where it is the nearest so far."""
    window = _window(np.linalg.inv(homography @ intrinsics), intrinsics, nearest.shape)
    if window is None:
        return
    x0, x1, y0, y1 = window
    xs, ys = np.arange(x0, x1) + 0.5, np.arange(y0, y1) + 0.5
    s, t, inverse_depth = (
        (row[0] * xs).astype(np.float32)[None, :] + (row[1] * ys + row[2]).astype(np.float32)[:, None]
        for row in homography
    )
    before = nearest[y0:y1, x0:x1]
    seen = (inverse_depth > before) & (s >= 0) & (s <= inverse_depth) & (t >= 0) & (t <= inverse_depth)
    np.copyto(before, inverse_depth, where=seen)
    np.copyto(owner[y0:y1, x0:x1], np.int16(number), where=seen)


def _shade(
    panel: Panel,
    homography: np.ndarray,
    pixels: np.ndarray,
    width: int,
    inverse_depth: np.ndarray,
    shadow: GroundShadow | None,
) -> np.ndarray:
    """Compute the linear light of the given pixels of one panel."""
    ys, xs = np.divmod(pixels.astype(np.int32), np.int32(width))
    xs, ys = xs.astype(np.float32) + np.float32(0.5), ys.astype(np.float32) + np.float32(0.5)
    depth = 1 / inverse_depth
    h = homography.astype(np.float32)
    s = (h[0, 0] * xs + h[0, 1] * ys + h[0, 2]) * depth
    t = (h[1, 0] * xs + h[1, 1] * ys + h[1, 2]) * depth
    pyramid = panel.pyramid
    texels_per_pixel = abs(np.linalg.det(homography)) * pyramid.sizes[0].prod()
    level = 0.5 * np.log2(np.float32(texels_per_pixel)) + np.float32(1.5) * np.log2(depth)
    level = np.clip(np.rint(level), 0, len(pyramid.sizes) - 1).astype(np.intp)
    at = pyramid.starts[level] + np.stack([s, t], axis=1).clip(0, 1) * pyramid.sizes[level] - np.float32(0.5)
    light = (_lookup(pyramid.atlas, at).astype(np.float32) * np.float32(np.sqrt(panel.light) / 255)) ** 2
    if panel.takes_shadow and shadow is not None:
        x = (panel.corner[0] - shadow.corner[0] + s * panel.right[0]) / shadow.texel - 0.5
        z = (panel.corner[2] - shadow.corner[1] + t * panel.down[2]) / shadow.texel - 0.5
        dark = _lookup(shadow.image, np.stack([x, z], axis=1).astype(np.float32))
        light *= (1 - dark * np.float32(1 - AMBIENT / panel.light))[:, None]
    return light


def _lookup(picture: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Interpolate a picture bilinearly at (n, 2) places in texels; 0 outside."""
    columns = 1024
    rows = -(-len(at) // columns)
    padded = np.zeros((2, rows * columns), np.float32)
    padded[:, : len(at)] = at.T
    x, y = padded.reshape(2, rows, columns)
    found = cv2.remap(picture, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
    return found.reshape(rows * columns, *picture.shape[2:])[: len(at)]


def _window(plane: np.ndarray, intrinsics: np.ndarray, shape: tuple[int, int]) -> tuple[int, int, int, int] | None:
    """Bound the part of a panel in front of the camera by a pixel box, or None."""
    st = np.array([(0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)], float)
    corners = st @ plane.T
    kept = []
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        if a[2] > _NEAR:
            kept.append(a)
        if (a[2] > _NEAR) != (b[2] > _NEAR):
            kept.append(a + (_NEAR - a[2]) / (b[2] - a[2]) * (b - a))
    if not kept:
        return None
    projected = np.asarray(kept) @ intrinsics.T
    pixels = projected[:, :2] / projected[:, 2:]
    height, width = shape
    low = np.clip(np.floor(pixels.min(axis=0)), 0, (width, height)).astype(int)
    high = np.clip(np.ceil(pixels.max(axis=0)), 0, (width, height)).astype(int)
    return None if (low >= high).any() else (low[0], high[0], low[1], high[1])
