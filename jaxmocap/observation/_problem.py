"""What one frame shows, as arrays: the record every energy, sampler and refiner reads."""

from dataclasses import replace
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, UInt8

from jaxmocap.camera import Cameras
from jaxmocap.character import Character, Pose, filled_up, skin
from jaxmocap.render import face_ids, inverse_depth_range, projection_matrices

from ._edges import image_edges
from ._light import relit
from ._rectangle import Rectangle
from ._surface import Surface

DEPTH_SLACK = 0.8
"""Metres around the predicted pose that inverse depths of a frame can express."""


class Edges(eqx.Module):
    """Image edges in the rectangle: where Canny fires, and the unit gradient (dx, dy) of the grey image there."""

    mask: Bool[Array, "camera height width"]
    gradient: Float[Array, "camera height width 2"]


class FrameProblem(eqx.Module):
    """One frame: cameras, the rectangle of sec. 4.1 in every view, its colours and its distances to the background.

    `origins` are row and column of each rectangle's first pixel in the full image, `pictures` its height and width.
    `labels` are palette indices, `background` is psi_b of Eq. 3. `area` is M_1 of Eq. 6, the pixels of the tight
    rectangle: the arrays may be larger, so that a sequence compiles once. `depth_range` bounds the inverse depths
    (1/metres) that keys can tell apart. `keypoints` are x, y in pixels of the undistorted image and the confidence of a
    detector's BODY_25 points, 0 where there is none; `keypoint_offsets` lead from the landmark that a point is to where
    the detector sees it, metres in the rest frame of the body that carries it (`carriers`).
    """

    intrinsics: Float[Array, "camera 3 3"]
    cam_from_world: Float[Array, "camera 4 4"]
    origins: Int[Array, "camera 2"]
    pictures: Float[Array, "camera 2"]
    image: Float[Array, "camera height width 3"]
    labels: Int[Array, "camera height width"]
    background: Float[Array, "camera height width"]
    depth_range: Float[Array, "camera 2"]
    area: Float[Array, ""]
    edges: Edges
    surface: Surface
    keypoints: Float[Array, "camera 25 3"]
    keypoint_offsets: Float[Array, "25 3"]

    @property
    def num_cameras(self) -> int:
        """How many views there are."""
        return self.image.shape[0]

    @property
    def size(self) -> tuple[int, int]:
        """Height and width of the rectangle."""
        return self.image.shape[1], self.image.shape[2]

    @property
    def room(self) -> Float[Array, "camera 4"]:
        """First row and column of each picture, and those behind its last ones, counted from the rectangle's first."""
        return jnp.concatenate([-self.origins, self.pictures - self.origins], axis=1)

    @property
    def projection(self) -> Float[Array, "camera 3 4"]:
        """K [R | t] of each view, to pixels of the full image."""
        return projection_matrices(self.intrinsics, self.cam_from_world)

    def with_keypoints(
        self,
        keypoints: Float[np.ndarray, "camera 25 3"] | None,
        offsets: Float[np.ndarray, "25 3"] | None = None,
    ) -> "FrameProblem":
        """Add what a detector found, and where it sees the landmarks; None leaves them as they are."""
        found = self.keypoints if keypoints is None else jax.device_put(np.asarray(keypoints, np.float32))
        moved = self.keypoint_offsets if offsets is None else jax.device_put(np.asarray(offsets, np.float32))
        return replace(self, keypoints=found, keypoint_offsets=moved)

    def coarser(self, step: int) -> "FrameProblem":
        """Keep every `step`-th pixel centre: point samples rank poses better than box-blurred images.

        `origins` and the rectangle must be multiples of `step`.
        """
        if step == 1:
            return self
        first = step // 2
        shift = 0.5 - (first + 0.5) / step
        scale = jnp.array([[1 / step, 0, shift], [0, 1 / step, shift], [0, 0, 1]], self.intrinsics.dtype)
        pick = (slice(None), slice(first, None, step), slice(first, None, step))
        return FrameProblem(
            intrinsics=jnp.matmul(scale, self.intrinsics, precision="highest"),
            cam_from_world=self.cam_from_world,
            origins=self.origins // step,
            pictures=self.pictures / step,
            image=self.image[pick],
            labels=self.labels[pick],
            background=self.background[pick],
            depth_range=self.depth_range,
            area=self.area / step**2,
            edges=Edges(self.edges.mask[pick], self.edges.gradient[pick]),
            surface=self.surface,
            keypoints=self.keypoints * jnp.array([1 / step, 1 / step, 1.0]) + jnp.array([shift, shift, 0.0]),
            keypoint_offsets=self.keypoint_offsets,
        )


def build_problem(
    images: list[UInt8[np.ndarray, "height width 3"]],
    rectangle: Rectangle,
    cameras: Cameras,
    frame: int,
    vertices: Float[np.ndarray, "vertex 3"],
    surface: Surface,
    labels: list[np.ndarray] | None = None,
    background: list[np.ndarray] | None = None,
    edges: list[tuple[np.ndarray, np.ndarray]] | None = None,
) -> FrameProblem:
    """Assemble the arrays of one frame, without keypoints. `vertices` (any pose near the answer) place the range of
    depths."""
    # arrays of the host by `device_put`: JAX 0.10 compiles a copy for every shape that `jnp.asarray` meets
    view = cameras.at(frame)
    crops = [rectangle.crop(image, camera) for camera, image in enumerate(images)]
    edges = [image_edges(crop) for crop in crops] if edges is None else edges
    shape = (len(crops), rectangle.height, rectangle.width)
    ranges = [inverse_depth_range(vertices, pose, DEPTH_SLACK) for pose in np.asarray(view.cam_from_world)]
    colours = np.zeros(shape, np.int32) if labels is None else np.stack(labels).astype(np.int32, copy=False)
    behind = np.ones(shape, np.float32) if background is None else np.stack(background).astype(np.float32, copy=False)
    return FrameProblem(
        intrinsics=view.intrinsics,
        cam_from_world=view.cam_from_world,
        origins=jax.device_put(np.asarray(rectangle.origins, np.int32)),
        pictures=jax.device_put(np.array([image.shape[:2] for image in images], np.float32)),
        image=jax.device_put(np.divide(np.stack(crops), np.float32(255), dtype=np.float32)),
        labels=jax.device_put(colours),
        background=jax.device_put(behind),
        depth_range=jax.device_put(np.stack(ranges)),
        area=jax.device_put(np.float32(rectangle.area)),
        edges=Edges(
            jax.device_put(np.stack([e[0] for e in edges])),
            jax.device_put(np.stack([e[1] for e in edges]).astype(np.float32, copy=False)),
        ),
        surface=surface,
        keypoints=jax.device_put(np.zeros((len(crops), 25, 3), np.float32)),
        keypoint_offsets=jax.device_put(np.zeros((25, 3), np.float32)),
    )


class FrameImages(NamedTuple):
    """One decoded frame: its position in the capture, time in seconds, and an undistorted RGB image per camera; `light`
    is what the images have been divided by to be in the light of the first one."""

    frame: int
    timestamp: float
    images: list[UInt8[np.ndarray, "height width 3"]]
    light: Float[np.ndarray, "camera 3"] | None = None

    def in_light(self, factors: Float[np.ndarray, "camera 3"]) -> "FrameImages":
        """Divide the decoded images by these factors."""
        return self._replace(images=relit(self.images, factors), light=factors)


class Frame(NamedTuple):
    """A frame as it is tracked: its images, the rectangle that is looked at in every view, and that as arrays."""

    shown: FrameImages
    rectangle: Rectangle
    problem: FrameProblem

    @property
    def number(self) -> int:
        """Position in the capture."""
        return self.shown.frame

    @property
    def timestamp(self) -> float:
        """Seconds."""
        return self.shown.timestamp

    def crops(self) -> list[UInt8[np.ndarray, "height width 3"]]:
        """Crop every view's image to its rectangle."""
        return [self.rectangle.crop(image, camera) for camera, image in enumerate(self.shown.images)]


def draw(character: Character, pose: Pose, problem: FrameProblem) -> tuple[Array, Array, Array]:
    """Draw the body in the rectangle: posed vertices, face ids and inverse depth."""
    vertices = skin(character, pose)
    height, width = problem.size
    ids, inverse = face_ids(
        vertices, character.faces, problem.intrinsics, problem.cam_from_world, problem.origins, height, width
    )
    return vertices, ids, inverse


def full_image_ids(
    character: Character, vertices: Float[Array, "vertex 3"], cameras: Cameras, frame: int
) -> list[np.ndarray]:
    """Draw face numbers over the whole image of every camera, -1 where the mesh is not seen."""
    view, filled = cameras.at(frame), filled_up(character)
    more = filled.vertices.shape[0] - vertices.shape[0]
    places = np.pad(np.asarray(vertices), ((0, more), (0, 0)), mode="edge")
    intrinsics, cam_from_world = np.asarray(view.intrinsics), np.asarray(view.cam_from_world)
    result = []
    for camera, (width, height) in enumerate(cameras.sizes):
        pick = slice(camera, camera + 1)
        ids, _ = face_ids(
            places,
            filled.faces,
            intrinsics[pick],
            cam_from_world[pick],
            np.zeros((1, 2), np.int32),
            height,
            width,
        )
        result.append(np.asarray(ids)[0])
    return result
