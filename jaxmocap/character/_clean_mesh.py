"""The mesh as the tracker needs it: one connected, outward-facing surface without seams."""

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree


def clean_mesh(
    vertices: np.ndarray, faces: np.ndarray, weights: np.ndarray, tolerance: float = 1e-6
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Weld seams, drop degenerate and repeated faces and unused vertices, and make all faces point outwards.

    `tolerance` is in the units of the vertices. Weights of welded vertices are averaged. Vertex order is kept.
    """
    label = _weld(vertices, tolerance)
    count = np.bincount(label).astype(np.float64)[:, None]
    first = np.full(len(count), len(vertices))
    np.minimum.at(first, label, np.arange(len(vertices)))
    summed = np.zeros((len(count), weights.shape[1]))
    np.add.at(summed, label, weights)
    vertices, weights, faces = vertices[first], summed / count, label[faces]

    a, b, c = faces.T
    faces = faces[(a != b) & (b != c) & (c != a)]
    _, keep = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)
    faces = faces[np.sort(keep)]
    used = np.unique(faces)
    renumber = np.zeros(len(vertices), dtype=np.int64)
    renumber[used] = np.arange(len(used))
    vertices, weights, faces = vertices[used], weights[used], renumber[faces]
    return vertices, _outwards(vertices, faces), weights


def signed_volume(vertices: np.ndarray, faces: np.ndarray) -> float:
    """Volume enclosed by outward-facing triangles; negative where they face inwards."""
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


def _weld(vertices: np.ndarray, tolerance: float) -> np.ndarray:
    """For every vertex its welded number; groups are numbered in the order of their first vertex."""
    pairs = KDTree(vertices).query_pairs(tolerance, output_type="ndarray")
    size = len(vertices)
    graph = coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(size, size))
    _, label = connected_components(graph, directed=False)
    _, first, inverse = np.unique(label, return_index=True, return_inverse=True)
    rank = np.empty(len(first), dtype=np.int64)
    rank[np.argsort(first)] = np.arange(len(first))
    return rank[inverse]


def _outwards(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Each connected part on its own, since parts of a character often disagree."""
    if len(faces) == 0:
        return faces
    size = len(vertices)
    rows, columns = faces.ravel(), np.roll(faces, 1, axis=1).ravel()
    _, part = connected_components(
        coo_matrix((np.ones(len(rows)), (rows, columns)), shape=(size, size)), directed=False
    )
    of_face = part[faces[:, 0]]
    centre = vertices.mean(axis=0)
    a, b, c = (vertices[faces[:, corner]] - centre for corner in range(3))
    volumes = np.bincount(of_face, np.einsum("ij,ij->i", a, np.cross(b, c)))
    return np.where((volumes[of_face] < 0)[:, None], faces[:, ::-1], faces)
