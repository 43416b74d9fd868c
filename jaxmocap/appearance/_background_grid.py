"""The deformable grid of background triangles (Fig. 4): vertices, triangles, and which triangle a pixel shows."""

from typing import Literal

import equinox as eqx
import numpy as np
from jaxtyping import Float, Int
from scipy.ndimage import distance_transform_edt

COARSE_PIXELS = 40_000
"""Size of the coarse id map in which uncovered pixels look for the nearest triangle."""


class GridSettings(eqx.Module):
    """Shape of the background grid and how it answers where it does not reach. All static.

    Attributes:
        rows: of cells, each cut into two triangles; 16 in the paper.
        columns: of cells; 16 in the paper.
        mask_dilation: pixels by which the person mask grows before the background is learnt.
        min_pixels: background pixels a triangle needs; one with fewer copies the nearest triangle that has a model.
        fill: "nearest": a pixel outside all triangles takes the nearest one (paper); "none": it has no model.
        blend: "nearest": the selected frame closest in time (paper); "min": the smaller psi of the two around.
    """

    rows: int = eqx.field(static=True, default=16)
    columns: int = eqx.field(static=True, default=16)
    mask_dilation: int = eqx.field(static=True, default=7)
    min_pixels: int = eqx.field(static=True, default=50)
    fill: Literal["nearest", "none"] = eqx.field(static=True, default="nearest")
    blend: Literal["nearest", "min"] = eqx.field(static=True, default="nearest")


def grid_vertices(height: int, width: int, rows: int = 16, columns: int = 16) -> Float[np.ndarray, "vertex 2"]:
    """Place the undeformed vertices (x, y) in pixels, row by row; the outer ones lie on the border, 0 and width."""
    x, y = np.meshgrid(np.linspace(0, width, columns + 1), np.linspace(0, height, rows + 1))
    return np.stack([x.ravel(), y.ravel()], axis=1)


def grid_triangles(rows: int = 16, columns: int = 16) -> Int[np.ndarray, "triangle 3"]:
    """List vertex indices: triangles 2c and 2c + 1 are the upper right and lower left half of cell c, row by row."""
    corner = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).ravel()
    right, below, opposite = corner + 1, corner + columns + 1, corner + columns + 2
    upper = np.stack([corner, right, opposite], axis=1)
    lower = np.stack([corner, opposite, below], axis=1)
    return np.stack([upper, lower], axis=1).reshape(-1, 3)


def similarity_residuals(
    vertices: Float[np.ndarray, "vertex 2"],
    rest: Float[np.ndarray, "vertex 2"],
    triangles: Int[np.ndarray, "triangle 3"],
) -> Float[np.ndarray, " triangle"]:
    """Measure how far each triangle is from a similar copy of its rest shape, in pixels; large for a mirrored one.

    The residual is that of the best similarity from the rest edges to the deformed edges, as complex numbers.
    """
    as_complex = lambda points: points[..., 0] + 1j * points[..., 1]  # noqa: E731
    before, after = (as_complex(points[triangles]) for points in (rest, vertices))
    before = before - before.mean(axis=1, keepdims=True)
    after = after - after.mean(axis=1, keepdims=True)
    factor = np.sum(after * before.conj(), axis=1) / np.sum(np.abs(before) ** 2, axis=1)
    return np.sqrt(np.sum(np.abs(after - factor[:, None] * before) ** 2, axis=1))


def grid_ids(
    vertices: Float[np.ndarray, "vertex 2"],
    height: int,
    width: int,
    settings: GridSettings | None = None,
    *,
    rest: Float[np.ndarray, "vertex 2"] | None = None,
    origin: tuple[int, int] = (0, 0),
) -> Int[np.ndarray, "height width"]:
    """Find the background triangle of every pixel of a window (Sec. 4.1): the deformed one that covers its centre.

    `vertices` are the warped grid in pixels of the whole image, `origin` the (y, x) of the window's first pixel,
    `height` and `width` the window's size. Where triangles fold over each other the one closest to a similar copy of
    its `rest` shape is kept (without `rest`: the one of lowest index). Uncovered pixels take the nearest triangle, to
    within a few pixels, or -1 with `fill="none"`.
    """
    settings = GridSettings() if settings is None else settings
    triangles = grid_triangles(settings.rows, settings.columns)
    vertices = np.asarray(vertices, np.float64)
    order = np.arange(len(triangles))[::-1]
    if rest is not None:
        order = np.argsort(-similarity_residuals(vertices, np.asarray(rest, np.float64), triangles), kind="stable")
    ids = _scan(vertices - (origin[1], origin[0]), triangles[order], order, height, width)
    uncovered = ids < 0
    if settings.fill == "nearest" and uncovered.any():
        y, x = np.nonzero(uncovered)
        ids[y, x] = _nearest_triangle(vertices - (origin[1], origin[0]), triangles[order], order, height, width, y, x)
    return ids


def _scan(
    vertices: np.ndarray, triangles: np.ndarray, labels: np.ndarray, height: int, width: int
) -> Int[np.ndarray, "height width"]:
    """Draw triangles in the given order, later ones over earlier ones; a pixel belongs to what covers its centre.

    Every triangle is cut into one span per pixel row; edges are walked from the same end in both of their triangles, so
    neighbours leave neither gaps nor overlaps.
    """
    low = np.clip(np.ceil(vertices[triangles, 1].min(axis=1) - 0.5), 0, height).astype(np.int64)
    high = np.clip(np.ceil(vertices[triangles, 1].max(axis=1) - 0.5), 0, height).astype(np.int64)
    counts = np.maximum(high - low, 0)
    owner = np.repeat(np.arange(len(triangles)), counts)
    row = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts) + low[owner]
    centre = row + 0.5
    left = np.full(len(owner), np.inf)
    right = np.full(len(owner), -np.inf)
    for first, second in ((0, 1), (1, 2), (2, 0)):
        ends = np.sort(triangles[:, [first, second]], axis=1)
        start, end = vertices[ends[:, 0]], vertices[ends[:, 1]]
        rise = end[:, 1] - start[:, 1]
        slope = (end[:, 0] - start[:, 0]) / np.where(rise == 0, 1.0, rise)
        crosses = (start[owner, 1] <= centre) != (end[owner, 1] <= centre)
        x = start[owner, 0] + (centre - start[owner, 1]) * slope[owner]
        left = np.where(crosses, np.minimum(left, x), left)
        right = np.where(crosses, np.maximum(right, x), right)
    left = np.clip(np.ceil(left - 0.5), 0, width).astype(np.int64)
    right = np.clip(np.ceil(right - 0.5), 0, width).astype(np.int64)
    lengths = np.maximum(right - left, 0)
    skip = row * width + left - (np.cumsum(lengths) - lengths)
    flat = np.arange(lengths.sum()) + np.repeat(skip, lengths)
    ids = np.full(height * width, -1, np.int32)
    ids[flat] = np.repeat(labels[owner].astype(np.int32), lengths)
    return ids.reshape(height, width)


def _nearest_triangle(
    vertices: np.ndarray,
    triangles: np.ndarray,
    labels: np.ndarray,
    height: int,
    width: int,
    y: np.ndarray,
    x: np.ndarray,
) -> Int[np.ndarray, " pixel"]:
    """Nearest triangle of window pixels (y, x), looked up in a coarse map of window and whole grid together."""
    corner = np.minimum(np.floor(vertices.min(axis=0)), 0)
    extent = np.maximum(np.ceil(vertices.max(axis=0)), (width, height)) - corner
    step = max(np.sqrt(extent[0] * extent[1] / COARSE_PIXELS), 1.0)
    columns, rows = (int(side) for side in np.ceil(extent / step))
    coarse = _scan((vertices - corner) / step, triangles, labels, rows, columns)
    if (coarse < 0).all():
        return np.full(len(y), -1, np.int32)
    nearest = np.asarray(distance_transform_edt(coarse < 0, return_distances=False, return_indices=True))
    filled = coarse[nearest[0], nearest[1]]
    return filled[((y + 0.5 - corner[1]) / step).astype(int), ((x + 0.5 - corner[0]) / step).astype(int)]
