"""As-similar-as-possible warp of the background grid from a selected frame to another frame."""

from dataclasses import dataclass, replace
from typing import Literal

import equinox as eqx
import numpy as np
from jaxtyping import Float

from ._background_grid import GridSettings, grid_vertices
from ._grid_equations import BandedNormal, bilinear_weights, similarity_normal
from ._homography import apply_homography, linear_equations, robust_homography

FEATURES_PER_CELL = 5.0
"""Density at which the values of `alphas` are meant; alpha grows and shrinks with the number of features."""


class WarpSettings(eqx.Module):
    """Constants of the grid warp (Liu, Yuan, Tan, Sun 2013, the paper's [51]). All static.

    Attributes:
        alphas: candidate weights of the similarity term, at five features per cell; one value fixes it. The choice is
            that of [51]: least mean feature residual in pixels plus 0.01 of the roughness between cells; it mostly
            falls on the smallest.
        choose_every: frames between two choices among `alphas` along one camera.
        scale: Geman-McClure scale of the data term, pixels.
        rounds: of reweighting.
        prewarp: "homography": similarity is asked of the deviation from a robust global homography, so that zoom,
            rotation and perspective cost nothing; "none": of the grid itself, as printed in [51].
        temporal: weight that keeps vertices away from all features where the previous frame had them.
    """

    alphas: tuple[float, ...] = eqx.field(static=True, default=(0.1, 0.3, 1.0, 3.0))
    choose_every: int = eqx.field(static=True, default=10)
    scale: float = eqx.field(static=True, default=2.0)
    rounds: int = eqx.field(static=True, default=5)
    prewarp: Literal["homography", "none"] = eqx.field(static=True, default="homography")
    temporal: float = eqx.field(static=True, default=0.1)


@dataclass(frozen=True)
class GridWarp:
    """A warped grid. `vertices` are (x, y) in pixels of the target frame, in the order of `grid_vertices`.

    `rest` is the pre-warped grid that the similarity term compares with, `homography` maps the selected frame to the
    target. `residual` is the robust mean of the feature residuals in pixels. `age` counts frames since `alpha` was
    chosen.
    """

    vertices: Float[np.ndarray, "vertex 2"]
    rest: Float[np.ndarray, "vertex 2"]
    homography: Float[np.ndarray, "3 3"]
    alpha: float
    residual: float
    age: int


def warp_grid(
    features_from: Float[np.ndarray, "feature 2"],
    features_to: Float[np.ndarray, "feature 2"],
    size: tuple[int, int],
    settings: WarpSettings | None = None,
    previous: GridWarp | None = None,
    *,
    grid: GridSettings | None = None,
) -> GridWarp:
    """Deform the grid of a selected frame so that it follows matched features into another frame (Sec. 4.1).

    Minimises sum_p |V b_p - p'|^2 + alpha sum |v - v1 - u (v0 - v1) - w R (v0 - v1)|^2 over the deformed vertices V,
    b_p being bilinear weights in the undeformed grid. We depart from [51] in two ways: the data term is reweighted
    (Geman-McClure), and the similarity term compares with the grid moved by a global homography (`prewarp="none"`
    brings the plain term back). Features are (x, y) in pixels of an image of `size` (height, width); `previous` is the
    warp of the same selected frame to the frame before, if any. Without features the grid stays where `previous`, or
    nothing, put it.
    """
    settings = WarpSettings() if settings is None else settings
    grid = GridSettings() if grid is None else grid
    features_from, features_to = np.asarray(features_from, np.float64), np.asarray(features_to, np.float64)
    regular = grid_vertices(*size, grid.rows, grid.columns)
    if len(features_from) == 0:
        return _unchanged(regular, settings, previous)
    homography = _safe_homography(features_from, features_to, regular)
    rest = apply_homography(homography, regular)
    similarity = similarity_normal(rest if settings.prewarp == "homography" else regular, grid.rows, grid.columns)
    corners, weights = bilinear_weights(features_from, size, grid.rows, grid.columns)
    anchor = _temporal_anchor(corners, homography, len(regular), settings, grid, previous)

    choose = previous is None or previous.age + 1 >= settings.choose_every
    candidates = settings.alphas if choose else (previous.alpha,)
    scale_alpha = len(features_from) / (FEATURES_PER_CELL * grid.rows * grid.columns)
    solutions = [
        _reweighted(corners, weights, features_to, rest, similarity, alpha * scale_alpha, anchor, settings)
        for alpha in candidates
    ]
    costs = [
        residual + 0.01 * _roughness(regular, vertices, grid) if len(candidates) > 1 else 0.0
        for vertices, residual in solutions
    ]
    best = int(np.argmin(costs))
    vertices, residual = solutions[best]
    return GridWarp(vertices, rest, homography, candidates[best], residual, 0 if choose else previous.age + 1)


def _safe_homography(features_from: np.ndarray, features_to: np.ndarray, regular: np.ndarray) -> np.ndarray:
    """Robust homography, or the median shift where it would turn or stretch the grid beyond use."""
    homography = robust_homography(features_from, features_to)
    denominator = regular @ homography[2, :2] + homography[2, 2]
    usable = np.isfinite(homography).all() and denominator.min() > 0.2 * denominator.max() > 0
    if usable and np.linalg.det(homography) > 0:
        return homography
    shift = np.eye(3)
    shift[:2, 2] = np.median(features_to - features_from, axis=0)
    return shift


def _unchanged(regular: np.ndarray, settings: WarpSettings, previous: GridWarp | None) -> GridWarp:
    if previous is not None:
        return replace(previous, residual=float("nan"), age=previous.age + 1)
    return GridWarp(regular, regular, np.eye(3), settings.alphas[0], float("nan"), settings.choose_every)


def _temporal_anchor(
    corners: np.ndarray,
    homography: np.ndarray,
    num_vertices: int,
    settings: WarpSettings,
    grid: GridSettings,
    previous: GridWarp | None,
) -> BandedNormal | None:
    """Pull on vertices of cells without features towards the previous grid, moved by the change of the homography."""
    if previous is None or settings.temporal == 0:
        return None
    lonely = np.ones(num_vertices, bool)
    lonely[corners] = False
    vertex = np.flatnonzero(lonely)
    moved = apply_homography(homography @ np.linalg.inv(previous.homography), previous.vertices)
    normal = BandedNormal(grid.columns, num_vertices)
    for axis in (0, 1):
        index = 2 * vertex[:, None] + axis
        normal.add(index, np.ones(index.shape), moved[vertex, axis], np.full(len(vertex), settings.temporal))
    return normal


def _reweighted(
    corners: np.ndarray,
    weights: np.ndarray,
    targets: np.ndarray,
    start: np.ndarray,
    similarity: BandedNormal,
    alpha: float,
    anchor: BandedNormal | None,
    settings: WarpSettings,
) -> tuple[np.ndarray, float]:
    """Fit by iteratively reweighted least squares for one alpha: vertices and robust mean residual.

    The Geman-McClure scale starts at three times the median residual of `start` and falls to `settings.scale`, so that
    parallax against the homography is not taken for an outlier.
    """
    residuals = lambda vertices: np.linalg.norm(  # noqa: E731
        np.einsum("pk,pkc->pc", weights, vertices[corners]) - targets, axis=1
    )
    errors = residuals(start)
    widest = max(settings.scale, 3 * float(np.median(errors)))
    vertices = start
    for scale in np.geomspace(widest, settings.scale, settings.rounds):
        confidence = (scale**2 / (scale**2 + errors**2)) ** 2
        data = similarity.empty()
        data.add_points(corners, weights, targets, confidence)
        system = data.plus(similarity, alpha)
        if anchor is not None:
            system = system.plus(anchor, 1.0)
        vertices = system.solve(start)
        errors = residuals(vertices)
    confidence = (settings.scale**2 / (settings.scale**2 + errors**2)) ** 2
    mean = float(np.sum(confidence * errors) / max(confidence.sum(), 1e-12))
    return vertices, mean


def _roughness(regular: np.ndarray, vertices: np.ndarray, grid: GridSettings) -> float:
    """Mean difference of neighbouring cells' homographies, each divided by the sum of its elements [51].

    Coordinates are shares of the image size: in pixels that sum can vanish.
    """
    extent = regular.max(axis=0)
    regular, vertices = regular / extent, vertices / extent
    rows, columns = grid.rows, grid.columns
    corner = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).ravel()
    cells = np.stack([corner, corner + 1, corner + columns + 1, corner + columns + 2], axis=1)
    equations = linear_equations(regular[cells].reshape(-1, 2), vertices[cells].reshape(-1, 2)).reshape(-1, 8, 9)
    solution = np.linalg.solve(equations[:, :, :8], -equations[:, :, 8:])[..., 0]
    cell = np.concatenate([solution, np.ones((len(solution), 1))], axis=1)
    cell = (cell / cell.sum(axis=1, keepdims=True)).reshape(rows, columns, 9)
    across = np.linalg.norm(cell[:, 1:] - cell[:, :-1], axis=-1).ravel()
    down = np.linalg.norm(cell[1:] - cell[:-1], axis=-1).ravel()
    return float(np.concatenate([across, down]).mean())
