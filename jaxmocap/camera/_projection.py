"""Pinhole projection, its inverse, and triangulation. Pure JAX, differentiable in every argument."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ._cameras import View

_EXACT = jax.lax.Precision.HIGHEST  # accelerators may otherwise round products to ten bits: several pixels
_SMALLEST_DEPTH = 1e-6


def _away_from_zero(depth: Float[Array, "..."]) -> Float[Array, "..."]:
    """The depth, kept off zero so that neither value nor gradient overflows."""
    return jnp.where(jnp.abs(depth) < _SMALLEST_DEPTH, _SMALLEST_DEPTH, depth)


def project(
    intrinsics: Float[Array, "... 3 3"], cam_from_world: Float[Array, "... 4 4"], points: Float[Array, "... point 3"]
) -> tuple[Float[Array, "... point 2"], Float[Array, "... point"]]:
    """Pinhole projection x = K (R X + t), without distortion: pixels and depth along the optical axis (metres).

    Leading axes broadcast. The centre of the first pixel is (0.5, 0.5). A point behind the camera has negative depth
    and a meaningless, finite pixel: mask by depth.
    """
    rotation, translation = cam_from_world[..., :3, :3], cam_from_world[..., None, :3, 3]
    in_camera = jnp.einsum("...ij,...nj->...ni", rotation, points, precision=_EXACT) + translation
    homogeneous = jnp.einsum("...ij,...nj->...ni", intrinsics, in_camera, precision=_EXACT)
    depth = in_camera[..., 2]
    return homogeneous[..., :2] / _away_from_zero(depth)[..., None], depth


def _normalised(
    intrinsics: Float[Array, "... 3 3"], pixels: Float[Array, "... point 2"]
) -> Float[Array, "... point 2"]:
    """Coordinates on the plane at unit depth, by back substitution through the triangular K."""
    offset = pixels - intrinsics[..., None, :2, 2]
    y = offset[..., 1] / intrinsics[..., None, 1, 1]
    x = (offset[..., 0] - intrinsics[..., None, 0, 1] * y) / intrinsics[..., None, 0, 0]
    return jnp.stack([x, y], axis=-1)


def pixel_rays(
    intrinsics: Float[Array, "... 3 3"], cam_from_world: Float[Array, "... 4 4"], pixels: Float[Array, "... point 2"]
) -> tuple[Float[Array, "... 3"], Float[Array, "... point 3"]]:
    """Viewing rays of pixels in the world: the optical centre (metres) and unit directions."""
    plane = _normalised(intrinsics, pixels)
    in_camera = jnp.concatenate([plane, jnp.ones_like(plane[..., :1])], axis=-1)
    in_camera = in_camera / jnp.linalg.norm(in_camera, axis=-1, keepdims=True)
    rotation, translation = cam_from_world[..., :3, :3], cam_from_world[..., :3, 3]
    centre = -jnp.einsum("...ji,...j->...i", rotation, translation, precision=_EXACT)
    return centre, jnp.einsum("...ji,...nj->...ni", rotation, in_camera, precision=_EXACT)


def _solve(
    normal: Float[Array, "point 3 3"], right: Float[Array, "point 3"], seen: Bool[Array, " point"]
) -> Float[Array, "point 3"]:
    safe = jnp.where(seen[:, None, None], normal, jnp.eye(3, dtype=normal.dtype))
    return jnp.linalg.solve(safe, jnp.where(seen[:, None], right, 0.0)[..., None])[..., 0]


def triangulate(
    views: View,
    pixels: Float[Array, "camera point 2"],
    weights: Float[Array, "camera point"],
    refinements: int = 3,
) -> Float[Array, "point 3"]:
    """Points seen in several views: the linear method (Hartley and Zisserman, 12.2), then Gauss-Newton steps.

    Minimises the weighted squared reprojection error in pixels; `refinements = 0` leaves the linear answer. A weight of
    zero means not seen, and whatever the pixel holds there is ignored. Points seen by fewer than two cameras are NaN.
    """
    count = jnp.sum(weights > 0, axis=0)
    seen = count >= 2
    pixels = jnp.where((weights > 0)[..., None], pixels, views.intrinsics[:, None, :2, 2])
    rotation, translation = views.cam_from_world[:, :3, :3], views.cam_from_world[:, :3, 3]
    centres = -jnp.einsum("cji,cj->ci", rotation, translation, precision=_EXACT)
    origin = jnp.mean(centres, axis=0)  # solving near the cameras keeps float32 exact far from the world's origin
    shift = jnp.einsum("cij,j->ci", rotation, origin, precision=_EXACT) + translation

    plane = _normalised(views.intrinsics, pixels)
    focal = jnp.stack([views.intrinsics[:, 0, 0], views.intrinsics[:, 1, 1]], axis=-1)
    scale = jnp.sqrt(weights)[..., None] * focal[:, None]
    rows = scale[..., None] * (plane[..., None] * rotation[:, None, 2:3] - rotation[:, None, :2])
    values = -scale * (plane * shift[:, None, 2:3] - shift[:, None, :2])
    points = _solve(
        jnp.einsum("cnki,cnkj->nij", rows, rows, precision=_EXACT),
        jnp.einsum("cnki,cnk->ni", rows, values, precision=_EXACT),
        seen,
    )

    def refine(points: Float[Array, "point 3"]) -> Float[Array, "point 3"]:
        in_camera = jnp.einsum("cij,nj->cni", rotation, points, precision=_EXACT) + shift[:, None]
        depth = _away_from_zero(in_camera[..., 2:])
        guess = in_camera[..., :2] / depth
        jacobian = (
            scale[..., None] * (rotation[:, None, :2] - guess[..., None] * rotation[:, None, 2:3]) / depth[..., None]
        )
        step = _solve(
            jnp.einsum("cnki,cnkj->nij", jacobian, jacobian, precision=_EXACT),
            jnp.einsum("cnki,cnk->ni", jacobian, scale * (plane - guess), precision=_EXACT),
            seen,
        )
        return points + step

    for _ in range(refinements):
        points = refine(points)
    return jnp.where(seen[:, None], points + origin, jnp.nan)
