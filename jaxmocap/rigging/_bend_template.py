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

    Displacements are as smooth over the template as the points allow. A joint moves by the mean displacement of the skin
    around it, so that it stays in the middle of its limb.
    """
    vertices, _ = surface(body)
    faces = np.asarray(template().faces)
    smooth = _laplacian(faces, len(vertices))
    tree = KDTree(target.keys())
    offset = np.zeros_like(vertices)
    for _ in range(_ROUNDS):
        now = vertices + offset
        normals = vertex_normals(now, faces)
        _, nearest = tree.query(Points(now, normals).keys())
        goal = target.places[nearest] - vertices
        off = target.places[nearest] - now
        like = np.sum(normals * target.normals[nearest], axis=1)
        weight = np.where(like > 0.5, 1.0, 0.0) / (1.0 + np.sum(off**2, axis=1) / _CUT**2) ** 2
        offset = _solve(smooth, weight, target.normals[nearest], goal)
    places = landmarks(body)
    moved = {}
    for name, place in places.items():
        near = np.exp(-0.5 * np.sum((vertices - place) ** 2, axis=1) / _REACH**2)
        moved[name] = place + near @ offset / max(near.sum(), 1e-9)
    return moved, vertices + offset


def _solve(smooth: sparse.csr_matrix, weight: np.ndarray, normal: np.ndarray, goal: np.ndarray) -> np.ndarray:
    """Displacements that meet `goal` across the surface, hardly along it, and are smooth."""
    size = len(weight)
    metric = weight[:, None, None] * (normal[:, :, None] * normal[:, None, :] + _ALONG * np.eye(3))
    blocks = sparse.bsr_matrix((metric, np.arange(size), np.arange(size + 1)), shape=(3 * size, 3 * size))
    energy = _STIFFNESS * (smooth.T @ smooth)
    system = blocks + sparse.kron(energy, sparse.eye(3)) + 1e-3 * sparse.eye(3 * size)
    return splu(system.tocsc()).solve(np.einsum("vij,vj->vi", metric, goal).ravel()).reshape(-1, 3)


def _laplacian(faces: np.ndarray, count: int) -> sparse.csr_matrix:
    """Each vertex less the mean of its neighbours."""
    ends = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    links = sparse.coo_matrix((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(count, count)).tocsr()
    return (sparse.eye(count) - sparse.diags(1.0 / np.maximum(links.sum(axis=1).A1, 1)) @ links).tocsr()
