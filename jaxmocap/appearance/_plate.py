"""The clean plate: the background as a picture, without its person, warped from frame to frame.

The grid's colour models (Sec. 3.2) know which colours a triangle of the background has, not where. Skin before a
skin-coloured pavement is then camouflage. The same grid warp can move the picture itself, and that tells a forearm
from the bricks behind it.
"""

from typing import NamedTuple

import cv2
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, UInt8

from jaxmocap._types import Knob, knob

from ._background_grid import GridSettings, grid_ids, grid_triangles, grid_vertices
from ._colour_model import TAU
from ._warp import GridWarp


class PlateSettings(eqx.Module):
    """How a pixel is compared with the picture that is expected behind the person. Not in the paper.

    Attributes:
        s0: colour distance that reaches the barrier tau, colours in [0, 1]: psi = (distance / s0)^2.
        unknown: psi_b of a pixel behind which nothing has been seen yet, so that the person has been there all along.
        shadow_low: when the plate is renewed, a pixel that is the old plate times a factor from this,
        shadow_high: to this, or over it, is background that a shadow reached or left; both 1: no shadows.
        blur: standard deviation in pixels of the smoothing of both pictures against sensor noise; static.
        reach: the best match within this many pixels counts, since a warp is only so exact; static.
        growth: pixels by which the person's silhouette grows before the rest is taken for background; static.
    """

    s0: Knob = knob(0.10)
    unknown: Knob = knob(0.5)
    shadow_low: Knob = knob(0.35)
    shadow_high: Knob = knob(0.75)
    blur: float = eqx.field(static=True, default=1.0)
    reach: int = eqx.field(static=True, default=2)
    growth: int = eqx.field(static=True, default=5)


class Plate(NamedTuple):
    """A camera's background at one frame, RGB, and where it is known."""

    picture: UInt8[np.ndarray, "height width 3"]
    known: Bool[np.ndarray, "height width"]

    def filled_from(self, other: "Plate") -> "Plate":
        """Fill what is not known of this plate from the other one."""
        picture = np.where(self.known[..., None], self.picture, other.picture)
        return Plate(picture, self.known | other.known)


def plate_beside(
    image: UInt8[np.ndarray, "height width 3"],
    person: Bool[np.ndarray, "height width"],
    settings: PlateSettings | None = None,
) -> Plate:
    """Make the plate of a frame whose person is marked: everything beside."""
    settings = PlateSettings() if settings is None else settings
    return Plate(image, ~_grown(person, settings.growth))


def warped_plate(plate: Plate, warp: GridWarp, grid: GridSettings | None = None) -> Plate:
    """Warp a plate into the frame to which `warp` carries its frame."""
    grid = GridSettings() if grid is None else grid
    height, width = plate.known.shape
    ids = grid_ids(warp.vertices, height, width, grid, rest=warp.rest)
    where = grid_coordinates(warp.vertices, ids, grid) - 0.5
    unknown = (~plate.known).astype(np.uint8)
    constant = cv2.BORDER_CONSTANT
    columns, rows = cv2.split(where)
    lost = cv2.remap(unknown, columns, rows, cv2.INTER_LINEAR, borderMode=constant, borderValue=(1,))
    picture = cv2.remap(plate.picture, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return Plate(picture, lost == 0)


def grid_coordinates(
    vertices: Float[np.ndarray, "vertex 2"], ids: Int[np.ndarray, "height width"], grid: GridSettings
) -> Float[np.ndarray, "height width 2"]:
    """Find where each pixel of an image comes from, (x, y) in the undeformed grid's image of the same size.

    `vertices` is the warped grid, `ids` the triangle at every pixel (`grid_ids`). Far outside where there is none.
    """
    triangles = grid_triangles(grid.rows, grid.columns)
    corners = np.concatenate([np.asarray(vertices, np.float64)[triangles], np.ones((len(triangles), 3, 1))], axis=-1)
    flat = np.abs(np.linalg.det(corners)) < 1e-6
    corners[flat] = np.eye(3)
    height, width = ids.shape
    regular = grid_vertices(height, width, grid.rows, grid.columns)
    affine = np.linalg.solve(corners, regular[triangles]).astype(np.float32)
    affine[flat] = -1e4
    picked = affine[np.maximum(ids, 0)]
    rows = np.arange(ids.shape[0], dtype=np.float32)[:, None, None] + 0.5
    columns = np.arange(ids.shape[1], dtype=np.float32)[None, :, None] + 0.5
    there = columns * picked[..., 0, :] + rows * picked[..., 1, :] + picked[..., 2, :]
    return np.where((ids >= 0)[..., None], there, np.float32(-1e4))


def plate_distance(
    plate: Plate,
    image: UInt8[np.ndarray, "height width 3"],
    settings: PlateSettings | None = None,
) -> Float[np.ndarray, "height width"]:
    """Compute psi_b of every pixel against a plate of the same window: min(tau, d^2 / s0^2).

    d is the least colour distance within `reach` pixels. It is `unknown` where the plate is not known.
    """
    settings = PlateSettings() if settings is None else settings
    pictures = _smoothed(plate.picture, settings.blur), _smoothed(image, settings.blur)
    distance = np.asarray(_least_square(*pictures, settings)) / np.float32(settings.s0) ** 2
    return np.where(plate.known, np.minimum(distance, np.float32(TAU)), np.float32(settings.unknown))


def renewed_plate(
    plate: Plate,
    image: UInt8[np.ndarray, "height width 3"],
    person: Bool[np.ndarray, "height width"],
    window: tuple[slice, slice],
    settings: PlateSettings | None = None,
) -> Plate:
    """Renew the plate after a frame has been tracked: with the image itself, but not everywhere.

    The old plate stays behind the person and, inside the `window` (rows, columns), where a pixel looks neither like it
    nor like its shadow: a limb that the tracker lost does not become background.
    """
    settings = PlateSettings() if settings is None else settings
    hidden = _grown(person, settings.growth)
    pictures = _smoothed(plate.picture[window], settings.blur), _smoothed(image[window], settings.blur)
    limit = 0.5 * float(settings.s0) ** 2
    foreign = np.asarray(_least_square(*pictures, settings)) > limit
    inside = cv2.erode(hidden[window].astype(np.uint8), np.ones((3, 3), np.uint8)) > 0  # kept in any case
    rows, columns = np.nonzero(foreign & ~inside)
    foreign[rows, columns] = _least_shaded_square(*pictures, rows, columns, settings) > limit
    keep = hidden.copy()
    keep[window] |= _grown(foreign, 1) & plate.known[window]
    return Plate(np.where(keep[..., None], plate.picture, image), plate.known | ~hidden)


def _smoothed(image: UInt8[np.ndarray, "height width 3"], blur: float) -> Float[np.ndarray, "height width 3"]:
    picture = image.astype(np.float32)
    return cv2.GaussianBlur(picture, (0, 0), blur) if blur > 0 else picture


def _grown(mask: Bool[np.ndarray, "height width"], pixels: int) -> Bool[np.ndarray, "height width"]:
    far = cv2.distanceTransform((np.asarray(mask) == 0).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5)
    return far <= pixels


@eqx.filter_jit
def _least_square(
    picture: Float[Array | np.ndarray, "height width 3"],
    seen: Float[Array | np.ndarray, "height width 3"],
    settings: PlateSettings,
) -> Float[Array, "height width"]:
    """Squared colour distance of each pixel to the nearest one in its surroundings."""
    height, width, _ = seen.shape
    reach = settings.reach
    padded = jnp.pad(jnp.asarray(picture) / 255, ((reach, reach), (reach, reach), (0, 0)), mode="edge")
    seen = jnp.asarray(seen) / 255
    taps = 2 * reach + 1

    def tap(index: Array, best: Array) -> Array:
        there = jax.lax.dynamic_slice(padded, (index // taps, index % taps, 0), (height, width, 3))
        return jnp.minimum(best, jnp.sum((seen - there) ** 2, axis=-1))

    return jax.lax.fori_loop(0, taps * taps, tap, jnp.full((height, width), jnp.inf))


def _least_shaded_square(
    picture: Float[np.ndarray, "height width 3"],
    seen: Float[np.ndarray, "height width 3"],
    rows: Int[np.ndarray, "pixel"],
    columns: Int[np.ndarray, "pixel"],
    settings: PlateSettings,
) -> Float[np.ndarray, "pixel"]:
    """Squared colour distance of some pixels to the nearest one in their surroundings, in shadow or out of it."""
    reach = settings.reach
    padded = np.pad(picture / 255, ((reach, reach), (reach, reach), (0, 0)), mode="edge")
    here = seen[rows, columns] / 255
    low, high = float(settings.shadow_low), float(settings.shadow_high)
    best = np.full(len(rows), np.inf, np.float32)
    for top in range(2 * reach + 1):
        for left in range(2 * reach + 1):
            there = padded[rows + top, columns + left]
            factor = (here * there).sum(1) / np.maximum((there**2).sum(1), 1e-6)
            factor = np.where(factor < 1, factor.clip(low, high), factor.clip(1 / high, 1 / low))
            best = np.minimum(best, ((here - factor[:, None] * there) ** 2).sum(1))
    return best
