"""The cameras of a capture, projection, its inverse, and triangulation. Pure JAX, differentiable in every argument."""

from collections.abc import Sequence
from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxmocap._shapes import check_shape

_EXACT = jax.lax.Precision.HIGHEST  # accelerators may otherwise round products to ten bits: several pixels
_SMALLEST_DEPTH = 1e-6


class View(eqx.Module):
    """All cameras at one instant: what `project` and the rasteriser take.

    Attributes:
        intrinsics: K, pixels; the centre of the first pixel is (0.5, 0.5).
        cam_from_world: poses, metres.
    """

    intrinsics: Float[Array, "camera 3 3"]
    cam_from_world: Float[Array, "camera 4 4"]


class Cameras(eqx.Module):
    """Calibrated cameras over the frames of a capture, moving or static.

    Attributes:
        names: one per camera.
        sizes: (width, height) of the pictures, pixels.
        intrinsics: K, pixels; the centre of the first pixel is (0.5, 0.5).
        distortion: k1 k2 p1 p2 k3 in OpenCV's order, of the videos as recorded; images are undistorted when they are
            decoded, so that projection never needs it.
        cam_from_world: poses, metres; x right, y down, z forward.
    """

    names: tuple[str, ...] = eqx.field(static=True)
    sizes: tuple[tuple[int, int], ...] = eqx.field(static=True)
    intrinsics: Float[Array, "camera 3 3"]
    distortion: Float[Array, "camera 5"]
    cam_from_world: Float[Array, "camera frame 4 4"]

    def __check_init__(self) -> None:
        count = len(self.names)
        check_shape("sizes of cameras", self.sizes, (count, 2), "width and height in pixels of each one that is named")
        check_shape("intrinsics of cameras", self.intrinsics, (count, 3, 3), "one matrix for each that is named")
        check_shape("distortion of cameras", self.distortion, (count, 5), "k1 k2 p1 p2 k3 of each that is named")
        check_shape("cam_from_world of cameras", self.cam_from_world, (count, "frame", 4, 4))

    @property
    def num_cameras(self) -> int:
        return self.cam_from_world.shape[0]

    @property
    def num_frames(self) -> int:
        return self.cam_from_world.shape[1]

    def at(self, frame: int) -> View:
        """Return all cameras at one frame. A `frame` outside the capture is an `IndexError`, unless JAX traces it."""
        if isinstance(frame, int | np.integer) and not 0 <= frame < self.num_frames:
            raise IndexError(f"frame {frame} is outside 0..{self.num_frames - 1}")
        return View(self.intrinsics, self.cam_from_world[:, frame])

    def only(self, which: Sequence[int]) -> "Cameras":
        """Return some of the cameras, by number."""
        names, sizes = tuple(self.names[one] for one in which), tuple(self.sizes[one] for one in which)
        index = np.asarray(which)
        return Cameras(names, sizes, self.intrinsics[index], self.distortion[index], self.cam_from_world[index])

    def resized(self, sizes: tuple[tuple[int, int], ...]) -> "Cameras":
        """Scale the cameras to pictures of other (width, height), which see as much."""
        if sizes == self.sizes:
            return self
        factors = jnp.array(sizes) / jnp.array(self.sizes)
        scale = jnp.concatenate([factors, jnp.ones_like(factors[:, :1])], axis=1)[:, :, None]
        return replace(self, sizes=sizes, intrinsics=self.intrinsics * scale)

    def turned(self, which: tuple[bool, ...]) -> "Cameras":
        """Turn the pictures of some cameras by a quarter to the left: x' = y, y' = width - x, pixels.

        They have no distortion then: pictures are turned after it has been removed.
        """
        if not any(which):
            return self
        chosen, widths = jnp.array(which), jnp.array([float(width) for width, _ in self.sizes])
        quarter = jnp.eye(4).at[:2, :2].set(jnp.array([[0.0, 1.0], [-1.0, 0.0]]))
        turns = jnp.where(chosen[:, None, None], quarter, jnp.eye(4))
        pixels, back = turns[:, :3, :3].at[:, 1, 2].add(chosen * widths), turns[:, :3, :3].mT
        return replace(
            self,
            sizes=tuple((h, w) if turn else (w, h) for (w, h), turn in zip(self.sizes, which, strict=True)),
            intrinsics=jnp.matmul(jnp.matmul(pixels, self.intrinsics, precision=_EXACT), back, precision=_EXACT),
            distortion=jnp.where(chosen[:, None], 0.0, self.distortion),
            cam_from_world=jnp.matmul(turns[:, None], self.cam_from_world, precision=_EXACT),
        )

    def centres(self) -> Float[Array, "camera frame 3"]:
        """Compute the optical centres in the world, metres: -R^T t."""
        rotation, translation = self.cam_from_world[..., :3, :3], self.cam_from_world[..., :3, 3]
        return -jnp.sum(rotation * translation[..., :, None], axis=-2)


def _check(intrinsics: Array, cam_from_world: Array) -> None:
    check_shape("intrinsics", intrinsics, ("...", 3, 3))
    check_shape("cam_from_world", cam_from_world, ("...", 4, 4), "of one frame, Cameras.at(frame).cam_from_world")


def _away_from_zero(depth: Float[Array, "..."]) -> Float[Array, "..."]:
    """Keep the depth off zero so that neither value nor gradient overflows."""
    return jnp.where(jnp.abs(depth) < _SMALLEST_DEPTH, _SMALLEST_DEPTH, depth)


def project(
    intrinsics: Float[Array, "... 3 3"], cam_from_world: Float[Array, "... 4 4"], points: Float[Array, "... point 3"]
) -> tuple[Float[Array, "... point 2"], Float[Array, "... point"]]:
    """Project by a pinhole, x = K (R X + t), without distortion: pixels and depth along the optical axis (metres).

    K is in pixels, R and t of `cam_from_world` and the points are in metres. Leading axes broadcast. The centre of the
    first pixel is (0.5, 0.5). A point behind the camera has negative depth and a meaningless, finite pixel: mask by
    depth. Raises `InputError` for arrays of other shapes.
    """
    _check(intrinsics, cam_from_world)
    check_shape("points", points, ("...", "point", 3), "metres in the world, a row for each, also of a single one")
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
    """Cast viewing rays through pixels into the world: the optical centre (metres) and unit directions.

    Raises `InputError` for arrays of other shapes.
    """
    _check(intrinsics, cam_from_world)
    check_shape("pixels", pixels, ("...", "point", 2), "column and row, a row for each, also of a single one")
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
    """Triangulate points from several views: the linear method (Hartley and Zisserman, 12.2), then Gauss-Newton steps.

    Minimises the weighted squared reprojection error in pixels; `refinements = 0` leaves the linear answer. A weight of
    zero means not seen, and whatever the pixel holds there is ignored. Points seen by fewer than two cameras are NaN.
    Raises `InputError` for arrays of other shapes.
    """
    cameras = views.intrinsics.shape[0]
    check_shape("pixels", pixels, (cameras, "point", 2), f"column and row in each of the {cameras} cameras")
    check_shape("weights", weights, (cameras, pixels.shape[1]), "one for each pixel")
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
