"""Surface points tied to optical rays: the residual of Eq. 9, whatever found the correspondence."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxmocap._cache import cached_jit
from jaxmocap.character import Character, Pose, retract, skin
from jaxmocap.geometry import inverse


class SurfaceLines(eqx.Module):
    """Points on the mesh (corner vertices and barycentric coordinates) and the Pluecker lines they should lie on.

    `direction` has unit length, `moment` = centre x direction, so `|v x n - m|` is the distance of point and line in
    metres. `weight` 0 switches a row off.
    """

    corners: Int[Array, "row 3"]
    barycentric: Float[Array, "row 3"]
    direction: Float[Array, "row 3"]
    moment: Float[Array, "row 3"]
    weight: Float[Array, "row"]

    def points(self, vertices: Float[Array, "vertex 3"]) -> Float[Array, "row 3"]:
        """Place the points on a posed mesh."""
        return jnp.einsum("rk,rkc->rc", self.barycentric, vertices[self.corners], precision="highest")

    def residual(self, vertices: Float[Array, "vertex 3"]) -> Float[Array, "row 3"]:
        """Compute v x n - m per row (Eq. 9), metres, unweighted."""
        return jnp.cross(self.points(vertices), self.direction) - self.moment

    def at(self, character: Character, pose: Pose) -> Float[Array, "row 3"]:
        """Compute the residual of a pose."""
        return self.residual(skin(character, pose))


def join_lines(*parts: SurfaceLines) -> SurfaceLines:
    """Join all rows, one after the other."""
    return SurfaceLines(
        *(
            jnp.concatenate([getattr(p, f) for p in parts])
            for f in ("corners", "barycentric", "direction", "moment", "weight")
        )
    )


def barycentric_at(
    corners: Float[Array, "row 3 3"], centre: Float[Array, "3"], direction: Float[Array, "row 3"]
) -> Float[Array, "row 3"]:
    """Find the barycentric point where a ray meets a triangle's plane, kept inside the triangle."""
    a, b, c = corners[:, 0] - centre, corners[:, 1] - centre, corners[:, 2] - centre
    volumes = jnp.stack(
        [
            jnp.sum(direction * jnp.cross(b, c), -1),
            jnp.sum(direction * jnp.cross(c, a), -1),
            jnp.sum(direction * jnp.cross(a, b), -1),
        ],
        axis=-1,
    )
    total = volumes.sum(-1, keepdims=True)
    raw = jnp.clip(volumes / jnp.where(jnp.abs(total) > 1e-12, total, 1.0), 0.0, 1.0)
    return raw / jnp.maximum(raw.sum(-1, keepdims=True), 1e-6)


def rays(
    intrinsics: Float[Array, "3 3"], cam_from_world: Float[Array, "4 4"], pixels: Float[Array, "row 2"]
) -> tuple[Float[Array, "3"], Float[Array, "row 3"], Float[Array, "row 3"]]:
    """Cast rays through pixels: camera centre, unit directions and moments (c x n), in the world."""
    rotation = cam_from_world[:3, :3]
    centre = -jnp.matmul(rotation.T, cam_from_world[:3, 3], precision="highest")
    ones = jnp.ones_like(pixels[:, :1])
    in_camera = jnp.matmul(jnp.concatenate([pixels, ones], -1), inverse(intrinsics).T, precision="highest")
    direction = jnp.matmul(in_camera, rotation, precision="highest")
    direction /= jnp.linalg.norm(direction, axis=-1, keepdims=True)
    return centre, direction, jnp.cross(jnp.broadcast_to(centre, direction.shape), direction)


@cached_jit
def surface_lines(
    vertices: Float[Array, "vertex 3"],
    faces: Int[Array, "face 3"],
    ids: Int[Array | np.ndarray, "row"],
    pixels: Float[Array, "row 2"],
    targets: Float[Array, "row 2"],
    weight: Float[Array, "row"],
    seen: tuple[Float[Array, "3 3"], Float[Array, "4 4"]],
    target: tuple[Float[Array, "3 3"], Float[Array, "4 4"]] | None = None,
) -> SurfaceLines:
    """Build rows from pixels of one view: what is seen at `pixels` should be seen at `targets`.

    The surface points are those of faces `ids`, the mesh being at `vertices`.

    `seen` and `target` are (intrinsics, cam_from_world) of the two pictures; one camera for both when `target` is None.
    Pixels in full-image coordinates, centres at +0.5.
    """
    corners = faces[jnp.maximum(ids, 0)]
    centre, direction, _ = rays(*seen, pixels)
    barycentric = barycentric_at(vertices[corners], centre, direction)
    _, direction, moment = rays(*(seen if target is None else target), targets)
    return SurfaceLines(corners, barycentric, direction, moment, jnp.where(ids >= 0, weight, 0.0))


class LineResidual(eqx.Module):
    """All rows of a set of lines as one residual vector of a pose increment, for a least-squares solver.

    `scale (row,)` divides the metres. `robust (row,)` is the Geman-McClure scale in the same units: a row contributes
    sigma^2 e^2 / (sigma^2 + e^2); infinity leaves it squared.
    """

    character: Character
    pose: Pose
    lines: SurfaceLines
    scale: Float[Array, "row"]
    robust: Float[Array, "row"]

    def __call__(self, increment: Float[Array, "dof"]) -> Float[Array, "rows"]:
        error = self.lines.at(self.character, retract(self.character.skeleton, self.pose, increment))
        square = jnp.sum(error**2, axis=-1) / self.robust**2
        factor = jnp.sqrt(self.lines.weight) * jax.lax.rsqrt(1.0 + square) / self.scale
        return (error * factor[:, None]).reshape(-1)
