"""Draw a posed mesh: in the rectangles of a problem, or over whole images."""

import numpy as np
from jaxtyping import Array, Float

from jaxmocap.camera import Cameras
from jaxmocap.character import Character, Pose, skin
from jaxmocap.render import face_ids

from ._problem import FrameProblem


def draw(character: Character, pose: Pose, problem: FrameProblem) -> tuple[Array, Array, Array]:
    """Posed vertices, face ids and inverse depth in the rectangle."""
    vertices = skin(character, pose)
    height, width = problem.size
    ids, inverse = face_ids(
        vertices, character.faces, problem.intrinsics, problem.cam_from_world, problem.origins, height, width
    )
    return vertices, ids, inverse


def full_image_ids(
    character: Character, vertices: Float[Array, "vertex 3"], cameras: Cameras, frame: int
) -> list[np.ndarray]:
    """Face numbers over the whole image of every camera, -1 where the mesh is not seen."""
    view = cameras.at(frame)
    intrinsics, cam_from_world = np.asarray(view.intrinsics), np.asarray(view.cam_from_world)
    result = []
    for camera, (width, height) in enumerate(cameras.sizes):
        pick = slice(camera, camera + 1)
        ids, _ = face_ids(
            vertices,
            character.faces,
            intrinsics[pick],
            cam_from_world[pick],
            np.zeros((1, 2), np.int32),
            height,
            width,
        )
        result.append(np.asarray(ids)[0])
    return result
