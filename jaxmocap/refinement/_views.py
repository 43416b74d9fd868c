"""Pictures of the posed mesh: those of the current frame, and those of other frames whose pose is known."""

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Array, Float, Int, UInt8

from jaxmocap.camera import Cameras
from jaxmocap.character import Character, Pose, skin
from jaxmocap.observation import FrameProblem
from jaxmocap.render import face_ids


class View(NamedTuple):
    """One picture of a mesh.

    Attributes:
        image: grey, from the first row and column of the picture on.
        intrinsics: of the camera.
        cam_from_world: of the camera.
        vertices: the posed mesh.
        ids: the faces seen, -1 where there is none.
        origin: row and column of the first of these in the image.
        same_time: whether it is of the current frame: its surface points then follow the pose that is refined.
    """

    image: UInt8[np.ndarray, "rows columns"]
    intrinsics: Float[np.ndarray, "3 3"]
    cam_from_world: Float[np.ndarray, "4 4"]
    vertices: Float[np.ndarray, "vertex 3"]
    ids: Int[np.ndarray, "height width"]
    origin: tuple[int, int] = (0, 0)
    same_time: bool = False

    @property
    def shown(self) -> UInt8[np.ndarray, "height width"]:
        """The image where `ids` tell what is seen."""
        (row, column), (height, width) = self.origin, self.ids.shape
        return self.image[row : row + height, column : column + width]

    def corners(self, faces: Int[np.ndarray, "face 3"]) -> Float[np.ndarray, "face 3 3"]:
        """Place the triangles in this camera's frame, in double precision: small ones far away need it."""
        turned = self.cam_from_world.astype(np.float64)
        return (self.vertices.astype(np.float64) @ turned[:3, :3].T + turned[:3, 3])[faces]


def known_view(
    character: Character,
    cameras: Cameras,
    image: UInt8[np.ndarray, "height width 3"],
    frame: int,
    camera: int,
    pose: Pose,
) -> View:
    """Make the view of one camera at a frame whose pose is known."""
    view = cameras.at(frame)
    vertices = skin(character, pose)
    width, height = cameras.sizes[camera]
    intrinsics, cam_from_world = np.asarray(view.intrinsics)[camera], np.asarray(view.cam_from_world)[camera]
    corner = np.zeros((1, 2), np.int32)
    ids, _ = face_ids(vertices, character.faces, intrinsics[None], cam_from_world[None], corner, height, width)
    return View(_grey(image), intrinsics, cam_from_world, np.asarray(vertices), np.asarray(ids)[0])


def current_views(
    crops: Sequence[UInt8[np.ndarray, "height width 3"]],
    problem: FrameProblem,
    vertices: Float[Array, "vertex 3"],
    ids: Int[Array | np.ndarray, "camera height width"],
) -> list[View]:
    """Make the views of the current frame from its rectangles; what lies before them in the picture is black."""
    cameras = zip(np.asarray(problem.intrinsics), np.asarray(problem.cam_from_world), strict=True)
    posed = np.asarray(vertices)
    places = zip(crops, np.asarray(problem.origins).tolist(), np.asarray(ids), strict=True)
    views = []
    for (intrinsics, cam_from_world), (crop, (row, column), seen) in zip(cameras, places, strict=True):
        whole = np.zeros((row + crop.shape[0], column + crop.shape[1]), np.uint8)
        whole[row:, column:] = _grey(crop)
        views.append(View(whole, intrinsics, cam_from_world, posed, seen, (row, column), same_time=True))
    return views


def _grey(image: UInt8[np.ndarray, "height width 3"]) -> UInt8[np.ndarray, "height width"]:
    """Convert RGB to grey."""
    return cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
