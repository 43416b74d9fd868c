"""The cameras of a capture: one set of intrinsics per camera, one pose per camera and frame."""

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float


class View(eqx.Module):
    """All cameras at one instant: what `project` and the rasteriser take."""

    intrinsics: Float[Array, "camera 3 3"]
    cam_from_world: Float[Array, "camera 4 4"]


class Cameras(eqx.Module):
    """Calibrated cameras over the frames of a capture, moving or static.

    `sizes` are (width, height) in pixels. `distortion` holds k1 k2 p1 p2 k3 in OpenCV's order and describes the videos
    as recorded: images are undistorted when they are decoded, so projection never needs it. Poses are in metres,
    x right, y down, z forward; the centre of the first pixel is (0.5, 0.5).
    """

    names: tuple[str, ...] = eqx.field(static=True)
    sizes: tuple[tuple[int, int], ...] = eqx.field(static=True)
    intrinsics: Float[Array, "camera 3 3"]
    distortion: Float[Array, "camera 5"]
    cam_from_world: Float[Array, "camera frame 4 4"]

    @property
    def num_cameras(self) -> int:
        return self.cam_from_world.shape[0]

    @property
    def num_frames(self) -> int:
        return self.cam_from_world.shape[1]

    def at(self, frame: int) -> View:
        """All cameras at one frame. A Python `frame` outside the capture is an `IndexError`."""
        if isinstance(frame, int) and not 0 <= frame < self.num_frames:
            raise IndexError(f"frame {frame} is outside 0..{self.num_frames - 1}")
        return View(self.intrinsics, self.cam_from_world[:, frame])

    def resized(self, sizes: tuple[tuple[int, int], ...]) -> "Cameras":
        """The same cameras with pictures of other (width, height), which see as much."""
        if sizes == self.sizes:
            return self
        factors = jnp.array(sizes) / jnp.array(self.sizes)
        scale = jnp.concatenate([factors, jnp.ones_like(factors[:, :1])], axis=1)[:, :, None]
        return replace(self, sizes=sizes, intrinsics=self.intrinsics * scale)

    def centres(self) -> Float[Array, "camera frame 3"]:
        """Optical centres in the world, metres: -R^T t."""
        rotation, translation = self.cam_from_world[..., :3, :3], self.cam_from_world[..., :3, 3]
        return -jnp.sum(rotation * translation[..., :, None], axis=-2)
