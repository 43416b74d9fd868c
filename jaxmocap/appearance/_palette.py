"""A palette of colours, so that psi of a pixel becomes one table look-up."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Integer, UInt8
from scipy.spatial import KDTree

from ._colour_model import TAU, ColourModel, ColourSettings, distance, whitening

LATTICE = 64
"""Colours are first rounded to a lattice of this many steps per channel."""
ROWS = 256
"""Elements per step while the table is built: bounds the memory."""


class Palette(eqx.Module):
    """Colours that stand for their surroundings in RGB, and the nearest one of every lattice cell.

    `colours` are RGB in [0, 1]; `nearest` has one entry per cell of a LATTICE^3 lattice, red slowest.
    """

    colours: Float[Array, "colour 3"]
    nearest: Integer[Array, " cell"]


def fit_palette(
    pixels: Float[Array | np.ndarray, "... 3"] | UInt8[np.ndarray, "... 3"], size: int = 1024, *, samples: int = 60_000
) -> Palette:
    """Fit a palette of `size` colours to the pixels (RGB in [0, 1] or uint8): median cut, then eight Lloyd steps.

    Deterministic; smaller if the pixels have fewer colours. At most `samples` evenly spread pixels are used; give the
    person's pixels their share, since a colour that the sample lacks is represented coarsely.
    """
    rgb = np.asarray(pixels)
    rgb = rgb.reshape(-1, 3).astype(np.float64) / (255 if rgb.dtype == np.uint8 else 1)
    rgb = rgb[np.arange(min(samples, len(rgb))) * len(rgb) // min(samples, len(rgb))]
    colours = _median_cut(rgb, size)
    for _ in range(8):
        owner = KDTree(colours).query(rgb)[1]
        sizes = np.bincount(owner, minlength=len(colours))
        sums = np.stack([np.bincount(owner, rgb[:, c], minlength=len(colours)) for c in range(3)], axis=1)
        colours = np.where(sizes[:, None] > 0, sums / np.maximum(sizes, 1)[:, None], colours)
    return palette_from_colours(colours)


def palette_from_colours(colours: Float[Array | np.ndarray, "colour 3"]) -> Palette:
    """Make a palette of given colours, RGB in [0, 1]."""
    entries = np.asarray(colours, np.float32)
    centres = (np.stack(np.meshgrid(*[np.arange(LATTICE)] * 3, indexing="ij"), axis=-1).reshape(-1, 3) + 0.5) / LATTICE
    nearest = KDTree(entries).query(centres)[1].astype(np.uint16 if len(entries) <= 65_536 else np.int32)
    return Palette(jnp.asarray(entries), jnp.asarray(nearest))


def _median_cut(rgb: np.ndarray, size: int) -> np.ndarray:
    """Means of `size` boxes, found by halving the box with the largest sum of squares; fewer if colours run out."""
    boxes = [rgb]
    spreads = [rgb.var(axis=0).sum() * len(rgb)]
    while len(boxes) < size:
        largest = int(np.argmax(spreads))
        box = boxes[largest]
        if spreads[largest] <= 1e-9:
            break
        axis = int(np.argmax(box.var(axis=0)))
        middle = box[:, axis].mean()
        halves = box[box[:, axis] <= middle], box[box[:, axis] > middle]
        boxes[largest], spreads[largest] = halves[0], halves[0].var(axis=0).sum() * len(halves[0])
        boxes.append(halves[1])
        spreads.append(halves[1].var(axis=0).sum() * len(halves[1]))
    return np.stack([box.mean(axis=0) for box in boxes])


def label_image(
    palette: Palette, image: UInt8[Array | np.ndarray, "*pixels 3"] | Float[Array | np.ndarray, "*pixels 3"]
) -> Integer[Any, "*pixels"]:
    """Look up the palette index of every pixel of a uint8 image, or of floats in [0, 1]: one look-up, no search.

    A NumPy image gives NumPy labels without compiling anything, so windows of any size are cheap; a JAX array gives JAX
    labels and may be traced.
    """
    numbers = np if isinstance(image, np.ndarray) else jnp
    if image.dtype == np.uint8:
        cell = image.astype(np.int32) * LATTICE // 256
    else:
        cell = numbers.clip((image * LATTICE).astype(np.int32), 0, LATTICE - 1)
    index = (cell[..., 0] * LATTICE + cell[..., 1]) * LATTICE + cell[..., 2]
    return numbers.take(numbers.asarray(palette.nearest), index, axis=0, mode="clip")


@eqx.filter_jit
def psi_table(
    model: ColourModel, palette: Palette, settings: ColourSettings | None = None, dtype: Any = jnp.float16
) -> Float[Array, "element colour"]:
    """Tabulate psi (Eq. 3) of every element at every palette colour; tau for elements without a model.

    The quadratic form is evaluated in its factored form, which stays accurate for tiny covariances where the expanded
    polynomial does not. Half precision by default: its rounding is far below that of the palette.
    """
    settings = ColourSettings() if settings is None else settings

    def row(parts: tuple[Array, Array, Array]) -> Array:
        means, whiten, offset = parts
        clusters = means.shape[0]
        to_colours = [palette.colours - means[k] for k in range(clusters)]
        per_cluster = [distance(to_colours[k], whiten[k], offset[k], settings) for k in range(clusters)]
        nearest = jnp.full(palette.colours.shape[0], TAU)
        for d in per_cluster:
            nearest = jnp.minimum(nearest, d)
        return nearest.astype(dtype)

    return jax.lax.map(row, (model.means, *whitening(model, settings)), batch_size=ROWS)
