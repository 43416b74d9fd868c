"""What one frame shows, as arrays: the record every energy, sampler and refiner reads."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, UInt32

from jaxmocap.appearance import ColourSettings, distance


class Clusters(eqx.Module):
    """The colour models behind `Surface.colour_distance`, for looking at single pixels without a palette: the means of
    their Gaussians, `whitening` and offset of Eq. 3."""

    means: Float[Array, "camera face cluster 3"]
    whiten: Float[Array, "camera face cluster 6"]
    offset: Float[Array, "camera face cluster"]
    settings: ColourSettings

    def distance(self, camera: Int[Array, "*#n"], face: Int[Array, "*#n"], colour: Float[Array, "*#n 3"]) -> Array:
        """psi_f of Eq. 3, exactly."""
        gap = colour[..., None, :] - self.means[camera, face]
        each = distance(gap, self.whiten[camera, face], self.offset[camera, face], self.settings)
        return jnp.minimum(each.min(-1), self.settings.tau)


class Surface(eqx.Module):
    """What is known of the character's surface, the same for all frames.

    `colour_distance (camera, face, colour)`: psi_f of Eq. 3 for every palette colour, tau where a face has no model.
    `near_faces (face, word)`: bit table of faces at most five edge steps apart (Eq. 7). `mean_colour` is the mean RGB
    of a face's model, meaningful where `has_colour`. `clusters` is None for a mesh without models of its own.
    """

    colour_distance: Float[Array, "camera face colour"]
    near_faces: UInt32[Array, "face word"]
    mean_colour: Float[Array, "camera face 3"]
    has_colour: Bool[Array, "camera face"]
    clusters: Clusters | None = None


class Edges(eqx.Module):
    """Image edges in the rectangle: where Canny fires, and the unit gradient (dx, dy) of the grey image there."""

    mask: Bool[Array, "camera height width"]
    gradient: Float[Array, "camera height width 2"]


class FrameProblem(eqx.Module):
    """One frame: cameras, the rectangle of sec. 4.1 in every view, its colours and its distances to the background.

    `origins` are row and column of each rectangle's first pixel in the full image. `labels` are palette indices,
    `background` is psi_b of Eq. 3. `area` is M_1 of Eq. 6, the pixels of the tight rectangle: the
    arrays may be larger, so that a sequence compiles once. `depth_range` bounds the inverse depths (1/metres) that
    keys can tell apart. `keypoints` are x, y in pixels of the undistorted image and the confidence of a
    detector's BODY_25 points, 0 where there is none.
    """

    intrinsics: Float[Array, "camera 3 3"]
    cam_from_world: Float[Array, "camera 4 4"]
    origins: Int[Array, "camera 2"]
    image: Float[Array, "camera height width 3"]
    labels: Int[Array, "camera height width"]
    background: Float[Array, "camera height width"]
    depth_range: Float[Array, "camera 2"]
    area: Float[Array, ""]
    edges: Edges
    surface: Surface
    keypoints: Float[Array, "camera 25 3"]

    @property
    def num_cameras(self) -> int:
        return self.image.shape[0]

    @property
    def size(self) -> tuple[int, int]:
        """Height and width of the rectangle."""
        return self.image.shape[1], self.image.shape[2]

    @property
    def projection(self) -> Float[Array, "camera 3 4"]:
        return self.intrinsics @ self.cam_from_world[:, :3]

    def coarser(self, step: int) -> "FrameProblem":
        """Every `step`-th pixel centre (point samples rank poses better than box-blurred images). `origins` and the
        rectangle must be multiples of `step`."""
        if step == 1:
            return self
        first = step // 2
        shift = 0.5 - (first + 0.5) / step
        scale = jnp.array([[1 / step, 0, shift], [0, 1 / step, shift], [0, 0, 1]], self.intrinsics.dtype)
        pick = (slice(None), slice(first, None, step), slice(first, None, step))
        return FrameProblem(
            intrinsics=scale @ self.intrinsics,
            cam_from_world=self.cam_from_world,
            origins=self.origins // step,
            image=self.image[pick],
            labels=self.labels[pick],
            background=self.background[pick],
            depth_range=self.depth_range,
            area=self.area / step**2,
            edges=Edges(self.edges.mask[pick], self.edges.gradient[pick]),
            surface=self.surface,
            keypoints=self.keypoints * jnp.array([1 / step, 1 / step, 1.0]) + jnp.array([shift, shift, 0.0]),
        )
