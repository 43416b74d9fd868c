"""Triangle meshes: normals, areas, and the dual graph that says which faces are a few edge steps apart (Eq. 7)."""

import numpy as np
import scipy.sparse as sparse
from jaxtyping import Float, Int, UInt32


def unit(vector: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    """Scale a vector to length 1; one of no length stays as it is."""
    return vector / max(float(np.linalg.norm(vector)), 1e-12)


def unit_vectors(vectors: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
    """Scale each vector to length 1; those of no length stay as they are."""
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)


def vertex_normals(
    vertices: Float[np.ndarray, "vertex 3"], faces: Int[np.ndarray, "face 3"]
) -> Float[np.ndarray, "vertex 3"]:
    """Compute outward unit normals, area-weighted means over the faces around each vertex."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    across = np.cross(b - a, c - a)
    index = faces.reshape(-1)
    sums = [np.bincount(index, np.repeat(across[:, i], 3), len(vertices)) for i in range(3)]
    return unit_vectors(np.stack(sums, axis=1))


def face_areas(vertices: Float[np.ndarray, "vertex 3"], faces: Int[np.ndarray, "face 3"]) -> Float[np.ndarray, "face"]:
    """Compute the area of each triangle, in the square of the vertices' unit."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)


def facing_cosine(
    corners: Float[np.ndarray, "face 3 3"], eye: Float[np.ndarray, "3"] | None = None
) -> Float[np.ndarray, "face"]:
    """Compute the cosine between each triangle's outward normal and the direction from its centre to the eye.

    The eye is by default the origin, as for corners in a camera's own frame.
    """
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    centre = corners.mean(1) if eye is None else corners.mean(1) - eye
    length = np.sqrt((normal**2).sum(1) * (centre**2).sum(1))
    return -(normal * centre).sum(1) / np.maximum(length, 1e-12)


def face_adjacency(faces: Int[np.ndarray, "face 3"]) -> sparse.csr_matrix:
    """Build a sparse matrix (face, face), true where two faces share an edge.

    Edges of three or more faces join them all.
    """
    count = len(faces)
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1).astype(np.int64)
    _, edge = np.unique(edges[:, 0] * (faces.max() + 1) + edges[:, 1], return_inverse=True)
    owner = np.tile(np.arange(count), 3)
    incidence = sparse.coo_matrix((np.ones(len(edge), np.int32), (owner, edge))).tocsr()
    shared = incidence @ incidence.T
    shared.setdiag(0)
    shared.eliminate_zeros()
    return shared.astype(bool).tocsr()


def faces_within(faces: Int[np.ndarray, "face 3"], steps: int = 5) -> sparse.csr_matrix:
    """Build a sparse matrix (face, face), true where the shortest path over shared edges has at most `steps` steps.

    A face is 0 steps from itself. Weld duplicate vertices first: a seam cuts the graph.
    """
    itself = sparse.csr_matrix(sparse.identity(len(faces)).astype(np.int32))
    reach, step = itself, sparse.csr_matrix(face_adjacency(faces).astype(np.int32) + itself)
    for _ in range(steps):
        reach = (reach @ step).astype(bool).astype(np.int32)
    return sparse.csr_matrix(reach.astype(bool))


def pack_rows(table: sparse.csr_matrix) -> UInt32[np.ndarray, "face word"]:
    """Pack the table into bits: faces i, j are near when `(row[i][j

    32] >> (j % 32)) & 1`. 3 MB for 5,000 faces.
    """
    count = len(table.indptr) - 1
    words = np.zeros((count, -(-count // 32)), np.uint32)
    rows, columns = table.nonzero()
    np.bitwise_or.at(words, (rows, columns // 32), np.uint32(1) << (columns % 32).astype(np.uint32))
    return words


def uniform_laplacian(faces: Int[np.ndarray, "face 3"], count: int) -> sparse.csr_array:
    """Build the uniform Laplacian of a closed mesh: each of `count` vertices less the mean of its neighbours."""
    ends = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    links = sparse.csr_array((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(count, count))
    mean = sparse.diags_array(1.0 / np.maximum(np.asarray(links.sum(axis=1)), 1)) @ links
    return sparse.csr_array(sparse.eye_array(count) - mean)


def face_components(faces: Int[np.ndarray, "face 3"]) -> tuple[int, Int[np.ndarray, "face"]]:
    """Count the connected pieces, and number the piece of each face."""
    count, labels = sparse.csgraph.connected_components(face_adjacency(faces), directed=False)
    return int(count), labels
