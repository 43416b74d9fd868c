"""Reflective markers: points of the skin, spread evenly and fixed to their triangles."""

import numpy as np
from jaxtyping import Float, Int


def bind_markers(
    vertices: Float[np.ndarray, "vertex 3"], faces: Int[np.ndarray, "face 3"], count: int, seed: int
) -> tuple[Int[np.ndarray, "marker"], Float[np.ndarray, "marker 3"]]:
    """Face and barycentrics of `count` points, each the farthest from those before among random ones on the surface."""
    rng = np.random.default_rng([seed, 6])
    corners = vertices[faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    candidates = rng.choice(len(faces), 2000, p=area / area.sum())
    barycentrics = rng.dirichlet((1.0, 1.0, 1.0), len(candidates))
    points = np.einsum("nc,ncd->nd", barycentrics, corners[candidates])
    chosen = [0]
    distance = np.full(len(points), np.inf)
    while len(chosen) < count:
        distance = np.minimum(distance, np.linalg.norm(points - points[chosen[-1]], axis=1))
        chosen.append(int(distance.argmax()))
    return candidates[chosen], barycentrics[chosen]


def marker_positions(
    vertices: Float[np.ndarray, "frame vertex 3"],
    faces: Int[np.ndarray, "face 3"],
    marker_faces: Int[np.ndarray, "marker"],
    barycentrics: Float[np.ndarray, "marker 3"],
) -> Float[np.ndarray, "frame marker 3"]:
    """The markers on a moving mesh, metres."""
    return np.einsum("mc,fmcd->fmd", barycentrics, vertices[:, faces[marker_faces]])
