"""Pictures of a bare mesh, for a detector of keypoints whose answer helps to rig it."""

from pathlib import Path

import cv2
import numpy as np
from jaxtyping import UInt8

from jaxmocap._files import atomic_folder, write_bytes
from jaxmocap._results import InputError
from jaxmocap.camera import Cameras, write_cameras
from jaxmocap.rigging import CAMERAS_FILE, Mesh, mesh_for_pictures, metres_per_unit_of

from ._faces import paint_face_ids
from ._overlay import face_colours

_SKIN, _WALL = (214, 178, 156), 120


def rig_pictures(
    mesh: str | Path | Mesh, folder: str | Path, *, up: str | None = None, front: str | None = None
) -> Cameras:
    """Draw a mesh from the front and from 45 degrees to both sides into a new folder, with `cameras.toml` beside.

    Run a detector of OpenPose's BODY_25 points on the pictures and write its JSON files beside them
    (`front_keypoints.json`); `rig(mesh, keypoints=folder)` then uses them. `mesh` is as in `rig`, `up` and `front` are
    axes of the file such as "z" or "-y" where the pictures do not show the person upright and from the front. The
    cameras returned are in the mesh's own units and axes. Raises `InputError` for what is no mesh, and for a folder
    that is not empty.
    """
    folder = Path(folder)
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError(f"{folder} exists already; choose a new or an empty folder for the pictures.")
    vertices, faces, cameras = mesh_for_pictures(mesh, up, front)
    with atomic_folder(folder) as new:
        write_cameras(cameras, new / CAMERAS_FILE, "aniposelib")
        for number, name in enumerate(cameras.names):
            write_bytes(new / f"{name}.png", _png(_draw(vertices, faces, cameras, number)))
    return cameras


def _draw(vertices: np.ndarray, faces: np.ndarray, cameras: Cameras, number: int) -> UInt8[np.ndarray, "h w 3"]:
    """Skin before a wall: detectors have learnt from photographs."""
    scale = metres_per_unit_of(vertices)
    intrinsics = np.asarray(cameras.intrinsics[number], np.float64)
    pose = np.array(cameras.cam_from_world[number, 0], np.float64)
    pose[:3, 3] *= scale
    ids = paint_face_ids(scale * vertices, faces, intrinsics, pose, cameras.sizes[number])
    colours = np.vstack([face_colours(scale * vertices, faces, pose, _SKIN), np.full((1, 3), _WALL, np.uint8)])
    return cv2.GaussianBlur(colours[ids], (3, 3), 0)


def _png(image: np.ndarray) -> bytes:
    return cv2.imencode(".png", cv2.cvtColor(image, cv2.COLOR_RGB2BGR))[1].tobytes()
