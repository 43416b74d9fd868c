"""Polygonising a signed distance into one closed triangle mesh (surface nets, Gibson 1998), in NumPy."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float, Int
from scipy import sparse

SignedDistance = Callable[[Float[np.ndarray, "point 3"]], Float[np.ndarray, "point"]]


def surface_nets(
    distance: SignedDistance, corners: Float[np.ndarray, "i j k 3"], relaxations: int = 8
) -> tuple[Float[np.ndarray, "vertex 3"], Int[np.ndarray, "face 3"]]:
    """Mesh the zero level of a signed distance (negative inside) on a grid of hexahedra.

    The mesh is closed, its faces counter-clockwise seen from outside.
    `corners` are the grid points, right-handed in (i, j, k); the grid may be bent and must contain the whole surface.
    After the nets are built the vertices are evened out along the surface and projected back onto it `relaxations`
    times. The mesh is a manifold where the surface is resolved: every gap and part at least about one cell wide.
    """
    values = distance(corners.reshape(-1, 3)).reshape(corners.shape[:3])
    vertices, quads = _nets(values, corners)
    step = float(np.linalg.norm(np.diff(corners, axis=0), axis=-1).mean())
    vertices = _relax(distance, vertices, quads, step, relaxations)
    return vertices, _split(vertices, quads)


def _nets(values: np.ndarray, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Put a vertex in each cell with corners on both sides, at the mean of its edge crossings, a quad on each edge."""
    inside = values < 0
    cells = tuple(size - 1 for size in values.shape)
    total, count, quads = np.zeros((*cells, 3)), np.zeros(cells, int), []
    cell_index = np.arange(np.prod(cells)).reshape(cells)
    for axis in range(3):
        low = [slice(None)] * 3
        high = [slice(None)] * 3
        low[axis], high[axis] = slice(None, -1), slice(1, None)
        crossed = inside[tuple(low)] != inside[tuple(high)]
        at = np.argwhere(crossed)
        a, b = values[tuple(low)][crossed], values[tuple(high)][crossed]
        along = (a / (a - b))[:, None]
        points = (1 - along) * corners[tuple(low)][crossed] + along * corners[tuple(high)][crossed]
        u, v = np.eye(3, dtype=int)[(axis + 1) % 3], np.eye(3, dtype=int)[(axis + 2) % 3]
        around = [at - u - v, at - v, at, at - u]
        for cell in around:
            np.add.at(total, tuple(cell.T), points)
            np.add.at(count, tuple(cell.T), 1)
        ring = np.stack([cell_index[tuple(cell.T)] for cell in around], axis=1)
        outwards = a < 0
        quads.append(np.where(outwards[:, None], ring, ring[:, ::-1]))
    active = count > 0
    number = np.full(cells, -1)
    number[active] = np.arange(active.sum())
    return total[active] / count[active][:, None], number.reshape(-1)[np.concatenate(quads)]


def _relax(
    distance: SignedDistance, vertices: np.ndarray, quads: np.ndarray, step: float, relaxations: int
) -> np.ndarray:
    """Move every vertex towards the mean of its neighbours, then back onto the surface along the gradient."""
    ends = np.concatenate([quads, np.roll(quads, -1, axis=1)]).reshape(2, -1)
    ones = np.ones(ends.shape[1])
    adjacency = sparse.coo_array((ones, (ends[0], ends[1])), shape=(len(vertices),) * 2).tocsr()
    adjacency = ((adjacency + adjacency.T) > 0).astype(float)
    mean = sparse.diags_array(1 / adjacency.sum(axis=1)) @ adjacency
    for _ in range(relaxations):
        vertices = _project(distance, vertices + 0.5 * (mean @ vertices - vertices), step)
    return _project(distance, _project(distance, vertices, step), step)


def _project(distance: SignedDistance, points: np.ndarray, step: float) -> np.ndarray:
    """Take one Newton step onto the surface, at most half a cell long."""
    value, width = distance(points), 1e-3 * step
    slope = np.stack([distance(points + shift) - value for shift in width * np.eye(3)], axis=1) / width
    move = -value[:, None] * slope / np.maximum((slope**2).sum(axis=1, keepdims=True), 1e-6)
    length = np.linalg.norm(move, axis=1, keepdims=True)
    return points + move * np.minimum(1.0, 0.5 * step / np.maximum(length, 1e-12))


def _split(vertices: np.ndarray, quads: np.ndarray) -> np.ndarray:
    """Split each quad along its shorter diagonal, or along the other one where that edge is already taken."""
    corner = vertices[quads]
    first = np.linalg.norm(corner[:, 0] - corner[:, 2], axis=1)
    second = np.linalg.norm(corner[:, 1] - corner[:, 3], axis=1)
    quads = np.where((first <= second)[:, None], quads, np.roll(quads, -1, axis=1))
    ends = np.sort(np.concatenate([np.stack([quads, np.roll(quads, -1, axis=1)], -1).reshape(-1, 2), quads[:, ::2]]))
    edge = ends[:, 0] * len(vertices) + ends[:, 1]
    sides, diagonals = edge[: 4 * len(quads)], edge[4 * len(quads) :]
    again = np.ones(len(quads), bool)
    again[np.unique(diagonals, return_index=True)[1]] = False
    taken = again | np.isin(diagonals, sides)
    quads = np.where(taken[:, None], np.roll(quads, -1, axis=1), quads)
    return np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]).astype(np.int32)
