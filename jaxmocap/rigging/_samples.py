"""Points of a surface, for fitting."""

import numpy as np
import trimesh
from jaxtyping import Float, Int

from jaxmocap.geometry import vertex_normals

from ._fit_template import Points

_COUNT = 4000


def samples(vertices: Float[np.ndarray, "vertex 3"], faces: Int[np.ndarray, "face 3"]) -> Points:
    """Points spread evenly over the surface, in random order but always the same."""
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    places, face = trimesh.sample.sample_surface(mesh, _COUNT, seed=0)[:2]
    corners = vertices[faces[face]]
    share = trimesh.triangles.points_to_barycentric(corners, places)
    normals = np.einsum("nc,nci->ni", share, vertex_normals(vertices, faces)[faces[face]])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    order = np.random.default_rng(0).permutation(len(places))
    return Points(np.asarray(places, np.float64)[order], normals[order])
