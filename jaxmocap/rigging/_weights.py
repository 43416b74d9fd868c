"""Skinning weights by bone heat (Baran and Popovic 2007): every bone warms the skin near it, and heat spreads over it.

`(L + H M) w_j = H M p_j` with `L` the cotangent and `M` the mass matrix, `p_j` whether bone j is the nearest, and
`H = c / distance^2`. Where the paper asks whether the bone can be seen from the skin, we ask whether the body laid into
the mesh has that bone under this spot: an arm that touches the flank, or a hole, misleads a ray and not this.
"""

from collections.abc import Mapping

import numpy as np
import robust_laplacian
from jaxtyping import Float, Int
from scipy import sparse
from scipy.sparse.linalg import splu
from scipy.spatial import KDTree

from jaxmocap.character import BODIES
from jaxmocap.geometry import vertex_normals

from ._fit_template import Points
from ._template import template

MAX_BONES = 4
HEAT = 3.0  # c; the published code's 1 in its own matrices
_LEAST = 0.01  # smaller weights are dropped
_UNDER = 0.3  # weight from which a body of the template counts as lying under its skin
_TIE = 1.0001
_PATCH = 3  # points of the template that are asked
_NAMES = [body for body, _, _ in BODIES]
_PARENTS = [_NAMES.index(parent) if parent else -1 for _, parent, _ in BODIES]

_CENTRE = {
    "pelvis": (("mid_hip", "spine"), ("l_hip", "r_hip")),
    "abdomen": (("spine", "thorax"),),
    "chest": (("thorax", "neck"), ("l_rib", "r_rib")),
    "head": (("neck", "head_top"),),
}
_SIDE = {
    "clavicle": (("clavicle", "shoulder"),),
    "upper_arm": (("shoulder", "elbow"),),
    "forearm": (("elbow", "wrist"),),
    "hand": (("wrist", "fingertip"),),
    "thigh": (("hip", "knee"),),
    "shank": (("knee", "ankle"),),
    "foot": (("ankle", "toe"), ("ankle", "heel")),
}


def skin_weights(
    vertices: Float[np.ndarray, "vertex 3"],
    faces: Int[np.ndarray, "face 3"],
    places: Mapping[str, np.ndarray],
    laid: Float[np.ndarray, "skin 3"],
    heat: float = HEAT,
) -> Float[np.ndarray, "vertex bone"]:
    """Compute a mesh's skin weights (V, 18): at most four bones each, none negative, rows that sum to 1.

    `places` are joints and landmarks in the mesh's rest pose, metres, and `laid` the vertices of the template laid into
    the mesh. Along the forearm the hand takes over linearly, so that turning it does not wring the wrist.
    """
    points = Points(vertices, vertex_normals(vertices, faces))
    admissible = _admissible(points, laid)
    distance = np.stack([_distance(vertices, _segments(name, places)) for name in _NAMES], axis=1)
    distance = np.maximum(np.where(admissible, distance, np.inf), 1e-4)
    nearest = distance.min(axis=1)
    ties = distance <= _TIE * nearest[:, None]
    stiffness, mass = robust_laplacian.mesh_laplacian(vertices, faces.astype(np.int64))
    area = mass.diagonal()
    warmth = heat * ties.sum(axis=1) / nearest**2 * area
    system = (stiffness + sparse.diags(warmth)).tocsc()
    weights = splu(system).solve(warmth[:, None] * (ties / ties.sum(axis=1, keepdims=True)))
    weights = _smoothed(np.clip(weights, 0.0, 1.0), faces)
    weights = unwrung(weights, vertices, places)
    return fewest(weights)


def _admissible(points: Points, laid: np.ndarray) -> np.ndarray:
    """Which bodies (V, 18) lie under the skin of the template nearest to each point."""
    character = template()
    skin = Points(laid, vertex_normals(laid, np.asarray(character.faces)))
    _, nearest = KDTree(skin.keys()).query(points.keys(), k=_PATCH)
    return (np.asarray(character.weights)[nearest] > _UNDER).any(axis=1)


def _segments(body: str, places: Mapping[str, np.ndarray]) -> list[tuple[np.ndarray, np.ndarray]]:
    side, part = (body[:2], body[2:]) if body[:2] in ("l_", "r_") else ("", body)
    pairs = _SIDE[part] if side else _CENTRE[part]
    return [(places[side + a], places[side + b]) for a, b in pairs]


def _distance(points: np.ndarray, segments: list[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    found = np.full(len(points), np.inf)
    for start, end in segments:
        axis = end - start
        along = np.clip((points - start) @ axis / max(axis @ axis, 1e-12), 0, 1)
        found = np.minimum(found, np.linalg.norm(points - start - along[:, None] * axis, axis=1))
    return found


def _smoothed(weights: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Halfway to the mean of the neighbours."""
    ends = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    ends = np.concatenate([ends, ends[:, ::-1]])
    links = sparse.coo_matrix((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(len(weights),) * 2).tocsr()
    return 0.5 * (weights + (links @ weights) / np.maximum(np.asarray(links.sum(axis=1)).ravel(), 1)[:, None])


def unwrung(weights: np.ndarray, vertices: np.ndarray, places: Mapping[str, np.ndarray]) -> np.ndarray:
    """Let the hand only turn about the forearm: its weight grows linearly from the elbow to the wrist."""
    weights = weights.copy()
    for side in "lr":
        elbow, wrist = places[f"{side}_elbow"], places[f"{side}_wrist"]
        axis = wrist - elbow
        along = np.clip((vertices - elbow) @ axis / (axis @ axis), 0.0, 1.0)
        forearm, hand = _NAMES.index(f"{side}_forearm"), _NAMES.index(f"{side}_hand")
        both = weights[:, forearm] + weights[:, hand]
        weights[:, hand] = along * both
        weights[:, forearm] = (1 - along) * both
    return weights


def fewest(weights: np.ndarray) -> np.ndarray:
    """Keep the four largest of each row, without specks, summing to 1."""
    weights = np.where(weights < _LEAST * weights.sum(axis=1, keepdims=True), 0.0, weights)
    rank = np.argsort(np.argsort(-weights, axis=1, kind="stable"), axis=1)
    weights = np.where(rank < MAX_BONES, weights, 0.0)
    return weights / weights.sum(axis=1, keepdims=True)
