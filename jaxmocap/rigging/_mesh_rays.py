"""Where lines of sight pass through a mesh (Moeller and Trumbore 1997)."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

_MANY = 50_000  # triangles at a time


class Crossing(NamedTuple):
    """A ray and a mesh: the point of the ray in the `middle` of the first limb it passes, or beside the part of the
    mesh that it misses least, and how far it misses (0 where it hits)."""

    middle: Float[np.ndarray, "3"]
    miss: float


def cross(
    vertices: Float[np.ndarray, "vertex 3"],
    faces: Int[np.ndarray, "face 3"],
    centre: Float[np.ndarray, "3"],
    direction: Float[np.ndarray, "3"],
) -> Crossing:
    """Pass a ray (a unit `direction` from `centre`) through a mesh, closed or not, in whatever units."""
    depths = _hits(vertices, faces, centre, direction)
    if len(depths):
        leaves = depths[1] if len(depths) > 1 else depths[0]
        return Crossing(centre + 0.5 * (depths[0] + leaves) * direction, 0.0)
    off = vertices - centre
    along = off @ direction
    apart = np.linalg.norm(off - along[:, None] * direction, axis=1)
    nearest = int(np.argmin(np.where(along > 0, apart, np.inf)))
    return Crossing(centre + along[nearest] * direction, float(apart[nearest]))


def _hits(vertices: np.ndarray, faces: np.ndarray, centre: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Sorted depths at which the ray meets the surface, an edge that two triangles share only once."""
    found = []
    for start in range(0, len(faces), _MANY):
        a, b, c = (vertices[faces[start : start + _MANY, corner]] for corner in range(3))
        ab, ac, off = b - a, c - a, centre - a
        across = np.cross(direction, ac)
        volume = np.einsum("fi,fi->f", ab, across)
        with np.errstate(divide="ignore", invalid="ignore"):
            u = np.einsum("fi,fi->f", off, across) / volume
            normal = np.cross(off, ab)
            v = normal @ direction / volume
            depth = np.einsum("fi,fi->f", ac, normal) / volume
            inside = (u >= 0) & (v >= 0) & (u + v <= 1) & (depth > 0)
        found.append(depth[inside])
    depths = np.sort(np.concatenate(found))
    same = 1e-6 * np.ptp(vertices, axis=0).max()
    return depths[np.diff(depths, prepend=-np.inf) > same]
