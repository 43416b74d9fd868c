"""Points fixed to a moving surface, and the agreement of silhouettes."""

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxmocap.geometry import intersection_over_union, unit_vectors

_POINTS_AT_ONCE = 16


def nearest_on_surface(
    points: Float[np.ndarray, "marker 3"], vertices: Float[np.ndarray, "vertex 3"], faces: Int[np.ndarray, "face 3"]
) -> tuple[Int[np.ndarray, " marker"], Float[np.ndarray, "marker 3"]]:
    """Find the nearest surface point of each point, exactly: its face and its barycentric coordinates.

    Every triangle is tried; the point on it is chosen among the six edges and corners and the inside as in Ericson,
    "Real-Time Collision Detection", 5.1.5. Degenerate triangles count as their edges.
    """
    corners = np.asarray(vertices, np.float64)[faces]
    found = [
        _nearest(chunk, corners) for chunk in np.split(points, range(_POINTS_AT_ONCE, len(points), _POINTS_AT_ONCE))
    ]
    return np.concatenate([face for face, _ in found]), np.concatenate([barycentric for _, barycentric in found])


def _nearest(points: np.ndarray, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    a, b, c = (corners[None, :, k] for k in range(3))
    p = np.asarray(points, np.float64)[:, None]
    ab, ac = b - a, c - a
    d1, d2 = _dot(ab, p - a), _dot(ac, p - a)
    d3, d4 = _dot(ab, p - b), _dot(ac, p - b)
    d5, d6 = _dot(ab, p - c), _dot(ac, p - c)
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    zero, one = np.zeros_like(d1), np.ones_like(d1)
    along_ab, along_ac = _ratio(d1, d1 - d3), _ratio(d2, d2 - d6)
    along_bc = _ratio(d4 - d3, (d4 - d3) + (d5 - d6))
    total = va + vb + vc
    inside_v, inside_w = _ratio(vb, total), _ratio(vc, total)
    at_a, at_b, at_c = (d1 <= 0) & (d2 <= 0), (d3 >= 0) & (d4 <= d3), (d6 >= 0) & (d5 <= d6)
    on_ab, on_ac = (vc <= 0) & (d1 >= 0) & (d3 <= 0), (vb <= 0) & (d2 >= 0) & (d6 <= 0)
    on_bc = (va <= 0) & (d4 >= d3) & (d5 >= d6)
    regions = [at_a, at_b, at_c, on_ab, on_ac, on_bc]
    v = np.select(regions, [zero, one, zero, along_ab, zero, 1 - along_bc], inside_v)
    w = np.select(regions, [zero, zero, one, zero, along_ac, along_bc], inside_w)
    nearest = a + v[..., None] * ab + w[..., None] * ac
    face = np.argmin(_dot(p - nearest, p - nearest), axis=1)
    v, w = (np.take_along_axis(values, face[:, None], axis=1)[:, 0] for values in (v, w))
    return face, np.stack([1 - v - w, v, w], axis=1)


def surface_points(
    corners: Float[np.ndarray, "*frame marker 3 3"], barycentric: Float[np.ndarray, "marker 3"]
) -> Float[np.ndarray, "*frame marker 3"]:
    """Place points at fixed barycentric coordinates of moving triangles, which `corners` holds."""
    return np.einsum("...mkd,mk->...md", corners, barycentric)


def triangle_frames(corners: Float[np.ndarray, "*frame marker 3 3"]) -> Float[np.ndarray, "*frame marker 3 3"]:
    """Build world_from_triangle, a rotation whose columns are first edge, in-plane normal and face normal."""
    first = unit_vectors(corners[..., 1, :] - corners[..., 0, :])
    normal = unit_vectors(np.cross(first, corners[..., 2, :] - corners[..., 0, :]))
    return np.stack([first, np.cross(normal, first), normal], axis=-1)


def silhouette_iou(a: Bool[np.ndarray, "height width"], b: Bool[np.ndarray, "height width"]) -> float:
    """Divide the intersection of two masks by their union; 1 where both are empty.

    Masks of different sizes are a `ValueError`.
    """
    a, b = np.asarray(a, bool), np.asarray(b, bool)
    if a.shape != b.shape:
        raise ValueError(f"masks have shapes {a.shape} and {b.shape}")
    return float(intersection_over_union(a, b, empty=1.0))


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.einsum("...d,...d->...", a, b)


def _ratio(numerator: np.ndarray, denominator: np.ndarray) -> np.ndarray:
    return np.clip(numerator / np.where(denominator == 0, 1.0, denominator), 0.0, 1.0)
