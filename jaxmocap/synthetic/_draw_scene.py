"""The surroundings as a camera sees them: one ray per pixel against every panel, and the actor's shadow on them."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float

from ._scene import AMBIENT, Panel, Scene

_NEAR = 0.05


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
