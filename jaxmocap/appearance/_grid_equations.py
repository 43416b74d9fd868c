"""Banded least squares over the vertices of a grid, and the rows of the similarity term."""

import numpy as np
from jaxtyping import Float
from scipy.linalg import solveh_banded

OPEN = 1e-6
"""Weight of the pull towards the pre-warped grid, for fewer features than a similarity needs."""


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


class BandedNormal:
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

    def empty(self) -> "BandedNormal":
        """Make a system of the same shape without equations."""
        return BandedNormal(self.columns, self.unknowns // 2)

    def plus(self, other: "BandedNormal", scale: float) -> "BandedNormal":
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


def similarity_normal(rest: np.ndarray, rows: int, columns: int) -> BandedNormal:
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
    normal = BandedNormal(columns, len(rest))
    one, none = np.ones_like(u), np.zeros(len(u))
    for axis, turn in ((0, w), (1, -w)):
        index = np.stack([2 * v + axis, 2 * v1 + axis, 2 * v0 + axis, 2 * v1 + 1 - axis, 2 * v0 + 1 - axis], axis=1)
        normal.add(index, np.stack([one, u - 1, -u, turn, -turn], axis=1), none, one)
    return normal
