"""Rhodin, Robertini, Richardt, Seidel, Theobalt: A versatile scene model with differentiable visibility applied to
generative pose estimation, ICCV 2015, as a term of the energy: one for the search and for going downhill."""

from typing import Any, ClassVar, Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int

from jaxmocap._types import Knob, knob
from jaxmocap.camera import pixel_rays
from jaxmocap.character import Character, Pose, Skeleton, blend
from jaxmocap.energies import AbstractPoseTerm, covered_cost, uncovered_cost
from jaxmocap.observation import FrameProblem, Surface
from jaxmocap.render import on_rays, quantile_samples, visibilities

from ._gaussian_body import Filling, filling


class GaussianVisibility(AbstractPoseTerm):
    """What the pixels' light costs: each Gaussian's share of it by how unlike the pixel it is, and the share that comes
    from behind by how unlike the background the pixel is; the mean over the rectangle, summed over the views.

    It looks at the pose and the picture, never at the drawn mesh, so that the search scores the very function that
    `polish` follows.

    Attributes:
        centres: of the Gaussians at rest, metres.
        sigmas: their standard deviations, metres.
        bones: weights of Eq. 1, a 1 in every row.
        distances: psi_f of every view, Gaussian and palette colour.
        weight: of the term; 1.
        opacity: share of the light that a Gaussian blocks on a ray through its centre; 0.95.
        width: factor of the standard deviations; 0.8, with which the body covers as many pixels as the mesh does.
        outside: cost of a pixel that a Gaussian would cover outside the rectangle; 1, as in `ModelView`.
        uncovered_scale: of the uncovered cost of Eq. 6, as in `ModelView`; 1, the paper's.
        cost: "distance", psi_f and psi_b, after the publication; "ratio", the two costs of Eq. 6.
        nearest: Gaussians that a ray meets, those that block most; 8, ours, which is off by some 4 % of the slope: the
            publication looks at all.
        samples: along each Gaussian; 4, ours: the publication has 5, one standard deviation apart.
        step: every so many pixels one is looked at; 1.
    """

    centres: Float[Array, "gaussian 3"]
    sigmas: Float[Array, "gaussian"]
    bones: Float[Array, "gaussian bone"]
    distances: Float[Array, "camera gaussian colour"]
    weight: Knob = knob(1.0)
    opacity: Knob = knob(0.95)
    width: Knob = knob(0.8)
    outside: Knob = knob(1.0)
    uncovered_scale: Knob = knob(1.0)
    cost: Literal["distance", "ratio"] = eqx.field(static=True, default="distance")
    nearest: int = eqx.field(static=True, default=8)
    samples: int = eqx.field(static=True, default=4)
    step: int = eqx.field(static=True, default=1)

    name: ClassVar[str] = "gaussian_visibility"

    def score_pose(self, skeleton: Skeleton, pose: Pose, frame: FrameProblem) -> Float[Array, ""]:
        places = blend(skeleton, pose, self.centres, self.bones)
        views = [frame.labels, frame.background, self.distances, frame.room]
        cost = lambda view: self._view(places, frame.size, _Lens(*view[:3]), *view[3:])  # noqa: E731
        covered, beyond = lax.map(cost, (frame.intrinsics, frame.cam_from_world, frame.origins, *views))
        return (self.step**2 * covered.sum() + self.outside * beyond.sum()) / frame.area

    def silhouette(self, skeleton: Skeleton, pose: Pose, frame: FrameProblem) -> Float[Array, "camera down across"]:
        """Compute the share of each pixel's light that comes from the body, every `step` pixels."""
        places, (height, width) = blend(skeleton, pose, self.centres, self.bones), frame.size
        rows, columns = jnp.mgrid[0 : height : self.step, 0 : width : self.step]
        look = lambda view: self.look(places, _Lens(*view), rows.ravel(), columns.ravel())[2]  # noqa: E731
        behind = lax.map(look, (frame.intrinsics, frame.cam_from_world, frame.origins))
        return 1.0 - behind.reshape(-1, *rows.shape)

    def look(
        self,
        places: Float[Array, "gaussian 3"],
        lens: "_Lens",
        rows: Int[Array, "pixel"],
        columns: Int[Array, "pixel"],
    ) -> tuple[Int[Array, "pixel nearest"], Float[Array, "pixel nearest"], Float[Array, "pixel"]]:
        """Find the Gaussians that pixels of a rectangle meet, their visibilities, and the light from behind."""
        centre, ways = lens.rays(rows, columns)
        sigmas, deepest, apart = self.width * self.sigmas, -jnp.log1p(-self.opacity), places - centre
        along, depths = on_rays(lax.stop_gradient(apart), sigmas, deepest, ways[:, None])
        _, which = lax.top_k(jnp.where(along > 0, depths, 0.0), min(self.nearest, len(self.sigmas)))
        along, depths = on_rays(apart[which], sigmas[which], deepest, ways[:, None])
        samples = quantile_samples(self.samples)
        shares, behind = jax.vmap(visibilities, (0, 0, 0, None))(along, sigmas[which], depths, samples)
        return which, shares, behind

    def _view(
        self,
        places: Float[Array, "gaussian 3"],
        size: tuple[int, int],
        lens: "_Lens",
        labels: Int[Array, "height width"],
        background: Float[Array, "height width"],
        distances: Float[Array, "gaussian colour"],
        room: Float[Array, "4"],
    ) -> tuple[Float[Array, ""], Float[Array, ""]]:
        """Sum the costs of a view's pixels, and the pixels of its picture that the body covers beside the rectangle.

        Rays are cast tile by tile; those that no Gaussian comes near see what lies behind.
        """
        side = _TILE * self.step
        down, across = (-(-extent // side) for extent in size)
        corners = side * jnp.stack(jnp.divmod(jnp.arange(down * across), across), -1)
        near = self._near(places, lens, corners)
        order = jnp.argsort(~near, stable=True)
        padded = jnp.pad(order, (0, -len(order) % _TOGETHER), constant_values=-1).reshape(-1, _TOGETHER)

        def some(tiles: Int[Array, "tile"]) -> Float[Array, ""]:
            place = self.step * jnp.stack(jnp.divmod(jnp.arange(_TILE**2), _TILE), -1)
            rows, columns = (corners[tiles][:, None] + place).reshape(-1, 2).T
            live = (rows < size[0]) & (columns < size[1]) & jnp.repeat(tiles >= 0, _TILE**2)
            rows, columns = jnp.minimum(rows, size[0] - 1), jnp.minimum(columns, size[1] - 1)
            psi_b = background[rows, columns]
            uncovered = self.uncovered_scale * uncovered_cost(psi_b) if self.cost == "ratio" else psi_b

            def covered(_: None) -> Float[Array, "pixel"]:
                which, shares, behind = self.look(places, lens, rows, columns)
                unlike = distances[which, labels[rows, columns][:, None]]
                unlike = covered_cost(unlike, psi_b[:, None]) if self.cost == "ratio" else unlike
                return jnp.sum(shares * unlike, -1) + behind * uncovered

            any_near = jnp.any(near[tiles] & (tiles >= 0))
            return jnp.sum(live * lax.cond(any_near, covered, lambda _: uncovered, None))

        return lax.map(some, padded).sum(), self._outside(places, size, lens, room)

    def _near(self, places: Float[Array, "gaussian 3"], lens: "_Lens", corners: Int[Array, "tile 2"]) -> Array:
        """Mark the tiles whose rays may come within `_REACH` standard deviations of a Gaussian."""
        middle = 0.5 * self.step * (_TILE - 1)
        centre, ways = lens.rays(*(corners + middle).T)
        apart = lax.stop_gradient(places) - centre
        along = jnp.matmul(ways, apart.T, precision="highest")
        aside = jnp.linalg.norm(apart - along[..., None] * ways[:, None], axis=-1)
        corner = np.sqrt(2.0) * middle * along / lens.intrinsics[0, 0]
        return jnp.any((along > 0) & (aside < corner + _REACH * self.width * self.sigmas), -1)

    def _outside(
        self, places: Float[Array, "gaussian 3"], size: tuple[int, int], lens: "_Lens", room: Float[Array, "4"]
    ) -> Float[Array, ""]:
        """Count the pixels of Gaussians that lie beside the rectangle, fading in over one standard deviation."""
        rotation, shift = lens.cam_from_world[:3, :3], lens.cam_from_world[:3, 3]
        local = jnp.matmul(places, rotation.T, precision="highest") + shift
        depth = jnp.maximum(local[:, 2:], _NEAREST)
        screen = jnp.matmul(local / depth, lens.intrinsics.T, precision="highest")[:, 1::-1] - lens.origin
        radius = lens.intrinsics[0, 0] * self.width * self.sigmas / depth[:, 0]
        beyond = jnp.max(jnp.maximum(-screen, screen - jnp.asarray(size)), -1)
        within = jnp.min(jnp.minimum(screen - room[:2], room[2:] - screen), -1)
        area = jnp.where(local[:, 2] > _NEAREST, jnp.minimum(np.pi * radius**2, _LARGEST), 0.0)
        return jnp.sum(area * jnp.clip(jnp.minimum(beyond, within) / radius, 0.0, 1.0))


class _Lens(NamedTuple):
    """A view, and row and column of its rectangle's first pixel."""

    intrinsics: Float[Array, "3 3"]
    cam_from_world: Float[Array, "4 4"]
    origin: Int[Array, "2"]

    def rays(self, rows: Array, columns: Array) -> tuple[Float[Array, "3"], Float[Array, "pixel 3"]]:
        """Cast the rays of pixels of the rectangle into the world: the camera's centre and unit vectors."""
        pixels = jnp.stack([columns + self.origin[1], rows + self.origin[0]], -1) + 0.5
        return pixel_rays(self.intrinsics, self.cam_from_world, pixels)


_TILE, _TOGETHER = 8, 16  # pixels of a tile's side that are looked at, and tiles at a time
_REACH = 4.5  # standard deviations, beyond which a Gaussian blocks less than 0.0002
_NEAREST = 0.1  # metres before the camera, where a projection is cut off
_LARGEST = 1e4  # pixels, of a Gaussian right before the camera


def gaussian_visibility(
    character: Character, surface: Surface, count: int = 300, **settings: Any
) -> GaussianVisibility:
    """Make the term for a character and what is known of its surface; `settings` are fields of the term (host)."""
    filled = filling(character, count)
    return GaussianVisibility(
        jnp.asarray(filled.centres, jnp.float32),
        jnp.asarray(filled.sigmas, jnp.float32),
        jnp.asarray(filled.bones),
        jnp.asarray(_distances(filled, surface), jnp.float32),
        **settings,
    )


def _distances(filled: Filling, surface: Surface) -> Float[np.ndarray, "camera gaussian colour"]:
    """Average psi_f over the faces around each Gaussian that a view knows, or any view, or else tau."""
    number = len(filled.sigmas)
    share = np.zeros((number, surface.has_colour.shape[1]), np.float32)
    np.add.at(share, (filled.gaussian, filled.face), filled.mass)
    tables, known = np.asarray(surface.colour_distance, np.float32), np.asarray(surface.has_colour, np.float32)
    sums, weights = np.stack([share @ (k[:, None] * t) for k, t in zip(known, tables, strict=True)]), share @ known.T
    weights = weights.T[..., None]
    anywhere = np.where(weights.sum(0) > 0, sums.sum(0) / np.maximum(weights.sum(0), 1e-12), 1.0)
    return np.where(weights > 0, sums / np.maximum(weights, 1e-12), anywhere)
