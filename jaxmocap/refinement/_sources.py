"""Pictures whose pose is known, from which a view is predicted."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Array, Float, Int, UInt8

from jaxmocap.camera import Cameras
from jaxmocap.character import Character, Pose, skin
from jaxmocap.observation import FrameProblem
from jaxmocap.render import face_ids


@dataclass(frozen=True)
class Source:
    """A picture whose pose is known: image, camera, posed mesh, and the faces seen in it (full image, -1 where empty).

    `same_time` marks another camera at the current frame: its surface points then follow the pose being refined.
    """

    image: UInt8[np.ndarray, "height width 3"]
    intrinsics: Float[Array, "3 3"]
    cam_from_world: Float[Array, "4 4"]
    vertices: Float[Array, "vertex 3"]
    ids: Int[Array, "source_height source_width"]
    origin: tuple[int, int] = (0, 0)
    same_time: bool = False


def picture_source(
    character: Character,
    cameras: Cameras,
    image: UInt8[np.ndarray, "height width 3"],
    frame: int,
    camera: int,
    pose: Pose,
) -> Source:
    """Make a source of one camera's picture of a frame whose pose is known."""
    view = cameras.at(frame)
    vertices = skin(character, pose)
    width, height = cameras.sizes[camera]
    intrinsics, cam_from_world = np.asarray(view.intrinsics)[camera], np.asarray(view.cam_from_world)[camera]
    corner = np.zeros((1, 2), np.int32)
    ids, _ = face_ids(vertices, character.faces, intrinsics[None], cam_from_world[None], corner, height, width)
    return Source(image, intrinsics, cam_from_world, vertices, np.asarray(ids)[0])


def padded(
    crop: UInt8[np.ndarray, "height width 3"], origin: Int[np.ndarray, "2"]
) -> UInt8[np.ndarray, "rows columns 3"]:
    """Put the crop at its row and column in an image that is black elsewhere, so that pixels keep their coordinates."""
    whole = np.zeros((crop.shape[0] + int(origin[0]), crop.shape[1] + int(origin[1]), 3), np.uint8)
    whole[int(origin[0]) :, int(origin[1]) :] = crop
    return whole


def same_time_sources(
    pictures: Sequence[UInt8[np.ndarray, "_ _ 3"]],
    problem: FrameProblem,
    vertices: Float[Array, "vertex 3"],
    ids: Sequence[np.ndarray] | np.ndarray | Int[Array, "camera height width"],
) -> list[Source]:
    """Make sources, for the other views, of what every view shows at the current frame.

    `pictures` keep the coordinates of the whole image (`padded`), `ids` are those of the rectangles.
    """
    intrinsics, cam_from_world = np.asarray(problem.intrinsics), np.asarray(problem.cam_from_world)
    views = zip(pictures, intrinsics, cam_from_world, ids, np.asarray(problem.origins).tolist(), strict=True)
    return [Source(p, k, t, vertices, seen, (row, column), same_time=True) for p, k, t, seen, (row, column) in views]
