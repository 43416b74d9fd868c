"""A mesh whose joints are known is bound to them."""

from collections.abc import Mapping

import numpy as np
import trimesh
from jaxtyping import Float, Int
from scipy.spatial import KDTree

from jaxmocap.character import REQUIRED, Character
from jaxmocap.geometry import vertex_normals

from ._fit_template import Points
from ._weights import skin_weights
from ._widen import evened, widened

_PRECISE = 8000  # triangles that weights are solved for; finer meshes take theirs from a simplified copy
_ALL_ELSE = ("spine", "thorax", "l_clavicle", "r_clavicle", "pelvis", "head")


def bind(
    name: str,
    vertices: Float[np.ndarray, "vertex 3"],
    faces: Int[np.ndarray, "face 3"],
    places: Mapping[str, np.ndarray],
    laid: Float[np.ndarray, "skin 3"],
) -> Character:
    """The character of a clean mesh in the rest frame (metres), with joints and landmarks at `places` and the
    template's skin `laid` into it: weights by bone heat, wider where joints would turn the skin inside out."""
    joints = {joint: places[joint] for joint in (*REQUIRED, *_ALL_ELSE)}
    few, their_faces = vertices, faces
    if len(faces) > _PRECISE:
        mesh = trimesh.Trimesh(vertices, faces, process=False).simplify_quadric_decimation(face_count=_PRECISE)
        few, their_faces = np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int64)
    weights = skin_weights(few, their_faces, places, laid)
    skeleton = Character.from_mesh(name, few, their_faces, weights, joints).skeleton
    weights = widened(few, their_faces, weights, places, skeleton)
    if few is not vertices:
        weights = evened(vertices, faces, _carried(weights, few, their_faces, vertices, faces))
    return Character.from_mesh(name, vertices, faces, weights, joints)


def _carried(
    weights: np.ndarray, few: np.ndarray, their_faces: np.ndarray, vertices: np.ndarray, faces: np.ndarray
) -> np.ndarray:
    """Weights for a fine mesh from the three nearest vertices of a coarse one on the same side of the body."""
    near = Points(few, vertex_normals(few, their_faces))
    distance, index = KDTree(near.keys()).query(Points(vertices, vertex_normals(vertices, faces)).keys(), k=3)
    share = 1.0 / np.maximum(distance, 1e-6)
    return np.einsum("vk,vkb->vb", share / share.sum(axis=1, keepdims=True), weights[index])
