"""Cameras around a mesh, for pictures in which a detector of keypoints finds the person."""

from pathlib import Path

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from jaxmocap._results import InputError
from jaxmocap.camera import Cameras

from ._fit_template import samples
from ._orientation import HEIGHT, guesses
from ._read_mesh import Mesh, named_axis, read_mesh
from ._repair import repaired

VIEWS = {"front": 0.0, "front_left": 45.0, "front_right": -45.0}  # degrees towards the person's left
PICTURE = (900, 1200)  # width and height, pixels
CAMERAS_FILE = "cameras.toml"
_TRIANGLES = 40_000
_DISTANCE, _FILLED = 3.0, 0.85  # of the mesh's largest extent; of the picture


def metres_per_unit_of(vertices: Float[np.ndarray, "vertex 3"]) -> float:
    """Find the scale at which a mesh, in whatever units, is as large as the template: only ratios are known yet."""
    return HEIGHT / max(float(np.ptp(vertices, axis=0).max()), 1e-12)


def mesh_for_pictures(
    mesh: str | Path | Mesh, up: str | None, front: str | None
) -> tuple[Float[np.ndarray, "vertex 3"], Int[np.ndarray, "face 3"], Cameras]:
    """Repair a mesh as `rig` takes it, and place cameras to draw it with; `up` and `front` are axes of the file."""
    directions = named_axis("up", up), named_axis("front", front)
    vertices, faces = read_mesh(Path(mesh)) if isinstance(mesh, str | Path) else mesh
    clean = repaired(str(mesh) if isinstance(mesh, str | Path) else "the mesh", vertices, faces, _TRIANGLES)
    return clean.vertices, clean.faces, picture_cameras(clean.vertices, clean.faces, *directions)


def picture_cameras(
    vertices: Float[np.ndarray, "vertex 3"],
    faces: Int[np.ndarray, "face 3"],
    up: Float[np.ndarray, "3"] | None = None,
    front: Float[np.ndarray, "3"] | None = None,
) -> Cameras:
    """Place three cameras (`VIEWS`) at the height of the middle of a repaired mesh, in its own units and axes.

    What is up and where the front is, is guessed; `up` and `front` (unit vectors in the file's axes) decide. Raises
    `InputError` where nothing in the mesh stands.
    """
    turn = _turn(vertices, faces, up, front)
    turned = vertices @ turn.T
    low, high = turned.min(axis=0), turned.max(axis=0)
    size = float((high - low).max())
    wide = float(np.linalg.norm((high - low)[[0, 2]]))
    focal = _FILLED * (_DISTANCE - 0.5) * size * min(PICTURE[0] / wide, PICTURE[1] / (high - low)[1])
    poses = [_pose(turn, (low + high) / 2, _DISTANCE * size, np.radians(degrees)) for degrees in VIEWS.values()]
    intrinsics = np.array([[focal, 0, PICTURE[0] / 2], [0, focal, PICTURE[1] / 2], [0, 0, 1]])
    return Cameras(
        tuple(VIEWS),
        (PICTURE,) * len(VIEWS),
        jnp.asarray(np.tile(intrinsics, (len(VIEWS), 1, 1)), jnp.float32),
        jnp.zeros((len(VIEWS), 5), jnp.float32),
        jnp.asarray(np.stack(poses)[:, None], jnp.float32),
    )


def _turn(vertices: np.ndarray, faces: np.ndarray, up: np.ndarray | None, front: np.ndarray | None) -> np.ndarray:
    """Rows are left, up and front, in the file's axes."""
    if up is not None and front is not None:
        if abs(up @ front) > 0.5:
            raise InputError("up and front are the same axis of the file; two that stand at right angles are needed.")
        return np.stack([np.cross(up, front), up, front])
    found = guesses(samples(vertices, faces), up, front)
    if not found:
        raise InputError(
            "the mesh shows no standing person in any orientation; say with --up and --front which way it stands."
        )
    turn = found[0].rest_from_file[:3, :3]
    return turn / np.cbrt(np.linalg.det(turn))


def _pose(turn: np.ndarray, middle: np.ndarray, distance: float, angle: float) -> np.ndarray:
    """Place a camera in the file's axes: level, turned by `angle` to the person's left."""
    outwards = np.array([np.sin(angle), 0.0, np.cos(angle)])
    down = np.array([0.0, -1.0, 0.0])
    rotation = np.stack([np.cross(down, -outwards), down, -outwards])
    pose = np.eye(4)
    pose[:3, :3] = rotation @ turn
    pose[:3, 3] = -rotation @ (middle + distance * outwards)
    return pose
