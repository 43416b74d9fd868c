"""Bare triangle meshes (OBJ, PLY, STL, OFF, GLB and whatever else trimesh reads), their units and their axes."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import trimesh
from jaxtyping import Float, Int

from jaxmocap._results import InputError
from jaxmocap.character import rest_frame

Mesh = tuple[Float[np.ndarray, "vertex 3"], Int[np.ndarray, "face 3"]]
"""Vertices and triangles."""

SUFFIXES = (".obj", ".ply", ".stl", ".off", ".glb", ".gltf")


def read_mesh(path: Path) -> tuple[Float[np.ndarray, "vertex 3"], Int[np.ndarray, "face 3"]]:
    """Read all triangles of a file, in its own units and axes, its parts where the scene puts them; skins are ignored.

    Raises `InputError` for a file that is not there, of no known form, damaged, or without triangles.
    """
    if not path.is_file():
        raise InputError(f"{path} does not exist; give the path of a mesh ({', '.join(SUFFIXES)}).")
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(f"{path} is not a known kind of mesh; one of {', '.join(SUFFIXES)} was expected.")
    try:
        scene = trimesh.load_scene(path, process=False, skip_materials=True)
        parts = [part for part in scene.dump() if isinstance(part, trimesh.Trimesh) and len(part.faces)]
    except Exception as error:  # readers of many formats raise whatever they like
        raise InputError(
            f"{path} cannot be read as a mesh ({type(error).__name__}: {error}); export it again."
        ) from None
    if not parts:
        raise InputError(f"{path} holds no triangles; a triangle mesh of a person is needed, not points or curves.")
    start = np.cumsum([0, *(len(part.vertices) for part in parts)])
    vertices = np.concatenate([np.asarray(part.vertices, np.float64) for part in parts])
    faces = np.concatenate([np.asarray(part.faces, np.int64) + low for part, low in zip(parts, start, strict=False)])
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise InputError(f"{path} has triangles that point past its {len(vertices)} vertices; the file is damaged.")
    return vertices, faces


UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254, "ft": 0.3048, "dm": 0.1}
ADULT, _ANYBODY = (1.3, 2.2), (0.3, 3.0)


def metres_per_unit(label: str, tall: float, height: float | None, units: str | None) -> tuple[float, str]:
    """Choose the scale of a person who is `tall` in the file's units, and name it.

    It comes from the `height` in metres, from `units`, or from what makes an adult. Raises `InputError` where none of
    that gives a person.
    """
    if height is not None:
        if not _ANYBODY[0] <= height <= _ANYBODY[1]:
            raise InputError(f"height is {height:g} m; {_ANYBODY[0]} to {_ANYBODY[1]} m was expected.")
        if units is not None:
            raise InputError("both a height and units are given; either of them fixes the scale.")
        return height / tall, "from the height"
    if units is not None:
        if units not in UNITS:
            raise InputError(f"units is {units!r}; one of {', '.join(UNITS)} was expected.")
        metres = tall * UNITS[units]
        if not _ANYBODY[0] <= metres <= _ANYBODY[1]:
            raise InputError(
                f"{label} is {metres:.4g} m tall in {units}; {_ANYBODY[0]} to {_ANYBODY[1]} m was expected."
            )
        return UNITS[units], units
    for name, factor in UNITS.items():
        if ADULT[0] <= factor * tall <= ADULT[1]:
            return factor, name
    if _ANYBODY[0] <= tall <= _ANYBODY[1]:
        return 1.0, "m"
    raise InputError(
        f"{label} is {tall:.4g} units tall, an adult in none of {', '.join(UNITS)}; give the height in metres "
        "(--height) or the units (--units)."
    )


AXES = {
    f"{sign}{'xyz'[axis]}": (-1.0 if sign == "-" else 1.0) * np.eye(3)[axis] for sign in ("", "-") for axis in range(3)
}
_TILT = 8.0  # degrees by which bones may miss an axis of the file that they mean


def upright(places: Mapping[str, np.ndarray]) -> Float[np.ndarray, "3 3"]:
    """Find the rotation from the file's axes to the rest frame's by the joints.

    Up is the axis of the file that is near, if any, and so is left, if up is; a scan may face in any direction, or hang
    in space.
    """
    left, up, _ = rest_frame(dict(places), near=0.0)
    vertical = _snapped(up)
    left = left - (left @ vertical) * vertical
    left /= np.linalg.norm(left)
    if vertical is not up:
        left = _snapped(left)
    return np.stack([left, vertical, np.cross(left, vertical)])


def _snapped(direction: np.ndarray) -> np.ndarray:
    nearest = max(AXES.values(), key=lambda axis: axis @ direction)
    return nearest if nearest @ direction > np.cos(np.radians(_TILT)) else direction


def named_axis(option: str, axis: str | None) -> Float[np.ndarray, "3"] | None:
    """Return the direction that an option names, such as "-y"; None for None."""
    if axis is None:
        return None
    if axis not in AXES:
        raise InputError(f"{option} is {axis!r}; one of the file's axes was expected: {', '.join(AXES)}.")
    return AXES[axis]


def axis_name(direction: np.ndarray) -> str:
    """Name a direction along an axis of the file "z" or "-y"; write any other as its three numbers."""
    unit = direction / np.linalg.norm(direction)
    for name, axis in AXES.items():
        if unit @ axis > 1 - 1e-6:
            return name
    return " ".join(f"{value:.2f}" for value in unit)
