"""Normals of a triangle mesh."""

import numpy as np
from jaxtyping import Float, Int


def vertex_normals(
    vertices: Float[np.ndarray, "vertex 3"], faces: Int[np.ndarray, "face 3"]
) -> Float[np.ndarray, "vertex 3"]:
    """Outward unit normals, area-weighted means over the faces around each vertex."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    across = np.cross(b - a, c - a)
    index = faces.reshape(-1)
    sums = [np.bincount(index, np.repeat(across[:, i], 3), len(vertices)) for i in range(3)]
    normals = np.stack(sums, axis=1)
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)


def facing_cosine(
    corners: Float[np.ndarray, "face 3 3"], eye: Float[np.ndarray, "3"] | None = None
) -> Float[np.ndarray, "face"]:
    """Cosine between each triangle's outward normal and the direction from its centre to the eye, by default the
    origin, as for corners in a camera's own frame."""
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    centre = corners.mean(1) if eye is None else corners.mean(1) - eye
    length = np.sqrt((normal**2).sum(1) * (centre**2).sum(1))
    return -(normal * centre).sum(1) / np.maximum(length, 1e-12)
