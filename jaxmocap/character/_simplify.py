"""A character with fewer faces, for drawing it small."""

import jax
import numpy as np
import trimesh
from jaxtyping import Int
from scipy.spatial import KDTree

from ._character import Character

_NEIGHBOURS = 3


def simplify(character: Character, num_faces: int) -> tuple[Character, Int[np.ndarray, "face"]]:
    """The character with about `num_faces` faces, and for every face of the original the nearest one of the new mesh
    (host).

    Quadric edge collapse (Garland and Heckbert 1997); a new vertex takes its weights from the three nearest old ones,
    by inverse distance. The skeleton is the same. A mesh that has no more faces than that is returned as it is.
    """
    vertices, faces = np.asarray(character.vertices), np.asarray(character.faces)
    if len(faces) <= num_faces:
        return character, np.arange(len(faces))
    mesh = trimesh.Trimesh(vertices, faces, process=False).simplify_quadric_decimation(face_count=num_faces)
    points, triangles = np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces, np.int32)
    distance, index = KDTree(vertices).query(points, k=_NEIGHBOURS)
    share = 1.0 / np.maximum(distance, 1e-6)
    share /= share.sum(1, keepdims=True)
    weights = np.einsum("vk,vkb->vb", share, np.asarray(character.weights)[index]).astype(np.float32)
    _, nearest = KDTree(points[triangles].mean(1)).query(vertices[faces].mean(1))
    simple = Character(
        character.name, character.skeleton, jax.device_put(points), jax.device_put(triangles), jax.device_put(weights)
    )
    return simple, np.asarray(nearest)
