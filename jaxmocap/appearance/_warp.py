"""As-similar-as-possible warp of the background grid from a selected frame to another frame."""

from dataclasses import dataclass, replace
from typing import Literal

import equinox as eqx
import numpy as np
from jaxtyping import Float
from scipy.linalg import solveh_banded

from ._background_grid import GridSettings, grid_vertices
from ._homography import apply_homography, linear_equations, robust_homography

FEATURES_PER_CELL = 5.0
"""Density at which the values of `alphas` are meant; alpha grows and shrinks with the number of features."""
OPEN = 1e-6
"""Weight of the pull towards the pre-warped grid, for fewer features than a similarity needs."""


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


def bilinear_weights(
    points: Float[np.ndarray, "point 2"], size: tuple[int, int], rows: int, columns: int
) -> tuple[np.ndarray, Float[np.ndarray, "point 4"]]:
    """Find the cell of each point in the undeformed grid of an image of `size` (height, width).

    Returns its corner vertices (point, 4) and the bilinear weights that reproduce the point.
    """
    height, width = size
    u = points[:, 0] / width * columns
    v = points[:, 1] / height * rows
    column = np.clip(np.floor(u), 0, columns - 1).astype(int)
    row = np.clip(np.floor(v), 0, rows - 1).astype(int)
    u, v = u - column, v - row
    corner = row * (columns + 1) + column
    corners = np.stack([corner, corner + 1, corner + columns + 1, corner + columns + 2], axis=1)
    return corners, np.stack([(1 - u) * (1 - v), u * (1 - v), (1 - u) * v, u * v], axis=1)


class _BandedNormal:
    """Symmetric banded normal equations over interleaved vertex coordinates (x0, y0, x1, y1, ...)."""

    def __init__(self, columns: int, num_vertices: int):
        self.columns = columns
        self.bandwidth = 2 * (columns + 2) + 1
        self.unknowns = 2 * num_vertices
        self.band = np.zeros((self.bandwidth + 1) * self.unknowns)
        self.right = np.zeros(self.unknowns)

    def add(self, index: np.ndarray, coefficients: np.ndarray, target: np.ndarray, weights: np.ndarray) -> None:
        """Add rows `coefficients . unknowns[index] = target`: arrays (row, k), (row, k), (row,), `weights` (row,)."""
        first, second = np.broadcast_arrays(index[:, :, None], index[:, None, :])
        product = coefficients[:, :, None] * coefficients[:, None, :] * weights[:, None, None]
        lower = first >= second
        place = (first - second)[lower] * self.unknowns + second[lower]
        self.band += np.bincount(place, product[lower], len(self.band))
        pull = coefficients * (weights * target)[:, None]
        self.right += np.bincount(index.ravel(), pull.ravel(), self.unknowns)

    def add_points(self, corners: np.ndarray, shares: np.ndarray, target: np.ndarray, weights: np.ndarray) -> None:
        """Add rows that ask the same of x and of y: `shares . vertices[corners] = target`, (row, 2)."""
        along_x = self.empty()
        along_x.add(2 * corners, shares, target[:, 0], weights)
        self.band += along_x.band
        self.band[1:] += along_x.band[:-1]  # y follows x in the order of unknowns
        pull = shares * (weights * target[:, 1])[:, None]
        self.right += along_x.right + np.bincount((2 * corners + 1).ravel(), pull.ravel(), self.unknowns)

    def empty(self) -> "_BandedNormal":
        """Make a system of the same shape without equations."""
        return _BandedNormal(self.columns, self.unknowns // 2)

    def plus(self, other: "_BandedNormal", scale: float) -> "_BandedNormal":
        """Add `scale` times another system to this one."""
        total = self.empty()
        total.band = self.band + scale * other.band
        total.right = self.right + scale * other.right
        return total

    def solve(self, towards: Float[np.ndarray, "vertex 2"]) -> Float[np.ndarray, "vertex 2"]:
        """Solve the equations; what they leave open is taken from `towards`."""
        band = self.band.reshape(self.bandwidth + 1, self.unknowns).copy()
        band[0] += OPEN
        return solveh_banded(band, self.right + OPEN * towards.ravel(), lower=True, check_finite=False).reshape(-1, 2)


def _similarity_normal(rest: np.ndarray, rows: int, columns: int) -> _BandedNormal:
    """Build the normal equations of the similarity term: v = v1 + u (v0 - v1) + w R (v0 - v1), R = [[0, 1], [-1, 0]].

    Four corners v1 per cell, both orders of the two legs: eight triples per cell. u and w are those of `rest`.
    """
    corner = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).ravel()
    a, b, c, d = corner, corner + 1, corner + columns + 2, corner + columns + 1
    triples = []
    for middle, leg, other in ((a, b, d), (b, c, a), (c, d, b), (d, a, c)):
        triples += [np.stack([other, middle, leg], axis=1), np.stack([leg, middle, other], axis=1)]
    v, v1, v0 = np.concatenate(triples).T
    e, f = rest[v0] - rest[v1], rest[v] - rest[v1]
    length = np.sum(e * e, axis=1)
    u = np.sum(f * e, axis=1) / length
    w = (f[:, 0] * e[:, 1] - f[:, 1] * e[:, 0]) / length
    normal = _BandedNormal(columns, len(rest))
    one, none = np.ones_like(u), np.zeros(len(u))
    for axis, turn in ((0, w), (1, -w)):
        index = np.stack([2 * v + axis, 2 * v1 + axis, 2 * v0 + axis, 2 * v1 + 1 - axis, 2 * v0 + 1 - axis], axis=1)
        normal.add(index, np.stack([one, u - 1, -u, turn, -turn], axis=1), none, one)
    return normal


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
    similarity = _similarity_normal(rest if settings.prewarp == "homography" else regular, grid.rows, grid.columns)
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
) -> _BandedNormal | None:
    """Pull on vertices of cells without features towards the previous grid, moved by the change of the homography."""
    if previous is None or settings.temporal == 0:
        return None
    lonely = np.ones(num_vertices, bool)
    lonely[corners] = False
    vertex = np.flatnonzero(lonely)
    moved = apply_homography(homography @ np.linalg.inv(previous.homography), previous.vertices)
    normal = _BandedNormal(grid.columns, num_vertices)
    for axis in (0, 1):
        index = 2 * vertex[:, None] + axis
        normal.add(index, np.ones(index.shape), moved[vertex, axis], np.full(len(vertex), settings.temporal))
    return normal


def _reweighted(
    corners: np.ndarray,
    weights: np.ndarray,
    targets: np.ndarray,
    start: np.ndarray,
    similarity: _BandedNormal,
    alpha: float,
    anchor: _BandedNormal | None,
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
