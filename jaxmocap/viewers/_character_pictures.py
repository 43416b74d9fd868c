"""Pictures of a character to look at before tracking, and of a bare mesh for a detector of keypoints."""

from pathlib import Path

import cv2
import jax.numpy as jnp
import numpy as np
from jaxtyping import UInt8

from jaxmocap._files import atomic_folder, write_bytes
from jaxmocap._results import InputError
from jaxmocap.camera import Cameras, write_cameras
from jaxmocap.character import Character, Pose, angles_at_rest, landmark_positions, skin
from jaxmocap.rigging import CAMERAS_FILE, Mesh, mesh_for_pictures, metres_per_unit_of

from ._overlay import OverlayStyle, contact_sheet, draw_overlay, face_colours, paint_face_ids

_POSES: tuple[tuple[str, dict[str, float], float], ...] = (  # degrees from the neutral body, and seen from where
    ("front", {}, 0.0),
    ("left", {}, 90.0),
    ("elbows", {"shoulder_flex": 0, "shoulder_abd": 0, "shoulder_axial": 0, "elbow_flex": 120}, 20.0),
    ("arms up", {"shoulder_flex": 0, "shoulder_abd": 70, "elbow_flex": 10, "clav_elev": 20}, 0.0),
    ("arms forward", {"shoulder_flex": 90, "shoulder_abd": -80, "elbow_flex": 10}, 60.0),
    ("forearms turned", {"shoulder_flex": 0, "shoulder_abd": -30, "elbow_flex": 10, "forearm_pron": 75}, 20.0),
    ("knees", {"hip_flex": 80, "knee_flex": 110}, 60.0),
    ("hips", {"hip_abd": 40, "hip_int": 20, "lumbar_flex": 30, "thorax_flex": 20}, 40.0),
)
_SIZE, _COLUMNS = (300, 400), 4
_DISTANCE = 20.0  # metres; so far that lines stay parallel
_PAPER = 30
_SKIN, _WALL = (214, 178, 156), 120


def draw_character(
    character: Character, colours: UInt8[np.ndarray, "vertex 3"] | None = None
) -> UInt8[np.ndarray, "height width 3"]:
    """Draw two views at rest with the joints, and six bent poses; an RGB picture.

    `colours` of the vertices, such as those of a scan, are shown where they are given.
    """
    return contact_sheet([_view(character, colours, *entry) for entry in _POSES], _COLUMNS)


def rig_pictures(
    mesh: str | Path | Mesh, folder: str | Path, *, up: str | None = None, front: str | None = None
) -> Cameras:
    """Draw a mesh from the front and from 45 degrees to both sides into a new folder, with `cameras.toml` beside.

    Run a detector of people on the pictures and write its JSON files, of any layout, beside them
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
            write_bytes(new / f"{name}.png", _png(_draw_mesh(vertices, faces, cameras, number)))
    return cameras


def _view(
    character: Character, colours: np.ndarray | None, label: str, degrees: dict[str, float], turn: float
) -> np.ndarray:
    skeleton, faces = character.skeleton, np.asarray(character.faces)
    pose = Pose(jnp.eye(4, dtype=skeleton.axes.dtype), jnp.asarray(_angles(character, degrees)))
    vertices = np.asarray(skin(character, pose), np.float64)
    joints = np.asarray(landmark_positions(skeleton, pose), np.float64)
    intrinsics, cam_from_world = _camera(vertices, turn)
    image = np.full((_SIZE[1], _SIZE[0], 3), _PAPER, np.uint8)
    if colours is not None:
        ids = paint_face_ids(vertices, faces, intrinsics, cam_from_world, _SIZE)
        shade = face_colours(vertices, faces, cam_from_world, (255, 255, 255)) / 255.0
        image[ids >= 0] = (shade * colours[faces].mean(1))[ids[ids >= 0]]
    return draw_overlay(
        image,
        vertices,
        faces,
        intrinsics,
        cam_from_world,
        joints=joints,
        joint_names=skeleton.landmark_names,
        label=label,
        style=OverlayStyle(opacity=0.85 if colours is None else 0.0, contour=0, bones=0 if degrees else 1),
    )


def _angles(character: Character, degrees: dict[str, float]) -> np.ndarray:
    """Joint angles of both sides, within the limits; those that are not named stay as at rest."""
    skeleton, at_rest = character.skeleton, angles_at_rest(character.skeleton)
    angles = np.zeros(skeleton.num_angles, np.float32)
    for number, name in enumerate(skeleton.angle_names):
        wanted = degrees.get(name, degrees.get(name[2:]))
        if wanted is not None:
            angles[number] = np.radians(wanted) - at_rest[number]
    return np.clip(angles, np.asarray(skeleton.lower), np.asarray(skeleton.upper))


def _camera(vertices: np.ndarray, turn: float) -> tuple[np.ndarray, np.ndarray]:
    """Place a camera far away that sees all vertices from the front, turned to the subject's left by degrees."""
    angle = np.radians(turn)
    forward = -np.array([np.sin(angle), 0.0, np.cos(angle)])
    rotation = np.stack([np.cross([0.0, -1.0, 0.0], forward), [0.0, -1.0, 0.0], forward])
    seen = vertices @ rotation.T
    low, high = seen.min(axis=0), seen.max(axis=0)
    middle = (low + high) / 2
    focal = 0.92 * _DISTANCE * min(_SIZE[0] / (high - low)[0], _SIZE[1] / (high - low)[1])
    cam_from_world = np.eye(4)
    cam_from_world[:3, :3], cam_from_world[:3, 3] = rotation, [-middle[0], -middle[1], _DISTANCE - middle[2]]
    return np.array([[focal, 0, _SIZE[0] / 2], [0, focal, _SIZE[1] / 2], [0, 0, 1]]), cam_from_world


def _draw_mesh(vertices: np.ndarray, faces: np.ndarray, cameras: Cameras, number: int) -> UInt8[np.ndarray, "h w 3"]:
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
