"""A picture as a sum of Gaussians: squares of a quadtree, each of about one colour (Stoll et al. 2011)."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

_LARGEST = 32
"""Side of the squares at which the tree begins, pixels: the body is no wider than a few of them."""


class ImageGaussians(NamedTuple):
    """Squares of one picture as Gaussians: centres (x, y) and standard deviations in pixels, half a side each, and mean
    colours."""

    centres: Float[np.ndarray, "square 2"]
    sigmas: Float[np.ndarray, "square"]
    colours: Float[np.ndarray, "square 3"]


def image_gaussians(
    picture: Float[np.ndarray, "height width 3"], tolerance: float = 0.15, smallest: int = 2
) -> ImageGaussians:
    """Cut a picture into squares: one whose colours have a standard deviation above `tolerance` is cut into four, down
    to `smallest` pixels, a power of two (host). The first pixel's centre is at (0.5, 0.5)."""
    height, width = picture.shape[:2]
    padded = np.pad(picture, ((0, -height % _LARGEST), (0, -width % _LARGEST), (0, 0)), mode="edge")
    parts, side = [], _LARGEST
    whole = np.ones((padded.shape[0] // side, padded.shape[1] // side), bool)
    while True:
        means, deviation = _blocks(padded, side)
        one_colour = deviation <= tolerance if side > smallest else np.ones_like(whole)
        rows, columns = np.nonzero(whole & one_colour)
        middle = (np.stack([columns, rows], 1) + 0.5) * side
        parts.append((middle, np.full(len(rows), 0.5 * side), means[rows, columns]))
        if side <= smallest:
            break
        whole = (whole & ~one_colour).repeat(2, 0).repeat(2, 1)
        side //= 2
    centres, sigmas, colours = (np.concatenate(part) for part in zip(*parts, strict=True))
    within = (centres < (width, height)).all(1)
    return ImageGaussians(centres[within], sigmas[within], colours[within])


def _blocks(
    picture: Float[np.ndarray, "height width 3"], side: int
) -> tuple[Float[np.ndarray, "row column 3"], Float[np.ndarray, "row column"]]:
    """Return mean colour and standard deviation, over all channels together, of every square."""
    height, width = picture.shape[0] // side, picture.shape[1] // side
    blocks = picture.reshape(height, side, width, side, 3)
    return blocks.mean((1, 3)), np.sqrt(blocks.var((1, 3)).sum(-1))
