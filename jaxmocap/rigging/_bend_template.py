"""The last centimetres: the fitted template bends smoothly to the surface, and its joints go along."""

import numpy as np
from jaxtyping import Float
from scipy import sparse
from scipy.sparse.linalg import splu
from scipy.spatial import KDTree

from jaxmocap.geometry import vertex_normals

from ._fit_template import Points
from ._template import Body, landmarks, surface, template

_ROUNDS = 6
_STIFFNESS = 40.0
_CUT = 0.04  # metres
_ALONG = 0.05
_REACH = 0.07  # metres around a joint whose surface tells where it is


def bent_landmarks(target: Points, body: Body) -> tuple[dict[str, np.ndarray], Float[np.ndarray, "vertex 3"]]:
    """Joints and landmarks of the body after its surface has been bent to the target, and that surface.

    Displacements are as smooth over the template as the points allow. A joint moves by the mean displacement of the
    skin around it, so that it stays in the middle of its limb.
    """
    vertices, _ = surface(body)
    faces = np.asarray(template().faces)
    smooth = _laplacian(faces, len(vertices))
    energy = smooth.transpose() @ smooth
    tree = KDTree(target.keys())
    offset = np.zeros_like(vertices)
    for _ in range(_ROUNDS):
        now = vertices + offset
        normals = vertex_normals(now, faces)
        _, nearest = tree.query(Points(now, normals).keys())
        there = target.normals[nearest]
        off = target.places[nearest] - now
        across = there * np.sum(there * off, axis=1, keepdims=True)
        goal = offset + across + _ALONG * (off - across)
        weight = np.where(np.sum(normals * there, axis=1) > 0.5, 1.0, 0.0)
        weight /= (1.0 + np.sum(off**2, axis=1) / _CUT**2) ** 2
        system = sparse.diags_array(weight + 1e-3) + _STIFFNESS * energy
        offset = splu(system.tocsc()).solve(weight[:, None] * goal)
    places = landmarks(body)
    moved = {}
    for name, place in places.items():
        near = np.exp(-0.5 * np.sum((vertices - place) ** 2, axis=1) / _REACH**2)
        moved[name] = place + near @ offset / max(near.sum(), 1e-9)
    return moved, vertices + offset


def _laplacian(faces: np.ndarray, count: int) -> sparse.csr_array:
    """Each vertex less the mean of its neighbours."""
    ends = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    links = sparse.csr_array((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(count, count))
    mean = sparse.diags_array(1.0 / np.maximum(np.asarray(links.sum(axis=1)), 1)) @ links
    return sparse.csr_array(sparse.eye_array(count) - mean)
