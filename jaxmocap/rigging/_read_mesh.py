"""Reading a bare triangle mesh: OBJ, PLY, STL, OFF, GLB and whatever else trimesh reads."""

from pathlib import Path

import numpy as np
import trimesh
from jaxtyping import Float, Int

from jaxmocap._results import InputError

Mesh = tuple[Float[np.ndarray, "vertex 3"], Int[np.ndarray, "face 3"]]
"""Vertices and triangles."""

SUFFIXES = (".obj", ".ply", ".stl", ".off", ".glb", ".gltf")


def read_mesh(path: Path) -> tuple[Float[np.ndarray, "vertex 3"], Int[np.ndarray, "face 3"]]:
    """All triangles of a file, in its own units and axes, its parts where the scene puts them. Skins are not looked at.

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
