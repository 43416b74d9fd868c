"""Making triangles agree where outside is."""

import numpy as np
from jaxtyping import Float, Int
from scipy import sparse
from scipy.sparse.csgraph import breadth_first_order, connected_components


def orient(
    vertices: Float[np.ndarray, "vertex 3"], faces: Int[np.ndarray, "face 3"]
) -> tuple[Int[np.ndarray, "face 3"], int]:
    """Faces turned so that neighbours agree and every connected part encloses a positive volume; how many were turned.

    Edges of more or fewer than two faces connect nothing.
    """
    directed = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    low, high = directed.min(axis=1), directed.max(axis=1)
    key = low * len(vertices) + high
    of_face = np.tile(np.arange(len(faces)), 3)
    order = np.argsort(key, kind="stable")
    ranked = key[order]
    first = np.flatnonzero(np.r_[True, ranked[1:] != ranked[:-1]])
    pairs = first[np.diff(np.r_[first, len(ranked)]) == 2]
    a, b = order[pairs], order[pairs + 1]
    opposed = (directed[a, 0] == directed[b, 0]).astype(np.int8)  # the same direction along an edge: they disagree
    flip = _parities(of_face[a], of_face[b], opposed, len(faces))
    turned = np.where(flip[:, None], faces[:, ::-1], faces)
    links = sparse.coo_matrix((np.ones(len(a), bool), (of_face[a], of_face[b])), shape=(len(faces),) * 2)
    count, part = connected_components(links, directed=False)
    p, q, r = (vertices[turned[:, corner]] for corner in range(3))
    centre = np.stack([np.bincount(part, p[:, axis], count) for axis in range(3)], axis=1)
    centre /= np.bincount(part, minlength=count)[:, None]
    p, q, r = p - centre[part], q - centre[part], r - centre[part]
    volume = np.bincount(part, np.einsum("fi,fi->f", p, np.cross(q, r)), count)
    turned = np.where((volume < 0)[part][:, None], turned[:, ::-1], turned)
    return turned, int(np.sum(flip ^ (volume < 0)[part]))


def _parities(a: np.ndarray, b: np.ndarray, opposed: np.ndarray, count: int) -> np.ndarray:
    """Per face whether to turn it, walking from face to face."""
    rows, columns = np.concatenate([a, b]), np.concatenate([b, a])
    values = np.concatenate([opposed, opposed]) + 1
    graph = sparse.csr_matrix((values, (rows, columns)), shape=(count, count))
    flip = np.zeros(count, bool)
    _, label = connected_components(graph, directed=False)
    if not opposed.any():
        return flip
    uneven = np.unique(label[a[opposed > 0]])
    for part in uneven:
        start = int(np.flatnonzero(label == part)[0])
        walk, before = breadth_first_order(graph, start, directed=False)
        steps = np.asarray(graph[before[walk[1:]], walk[1:]]).ravel() > 1
        for face, source, step in zip(walk[1:], before[walk[1:]], steps, strict=True):
            flip[face] = flip[source] ^ step
    return flip
