"""A mesh whose joints are known is bound to them, with blends wide enough for what the joints can do."""

from collections.abc import Callable, Mapping
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import robust_laplacian
import trimesh
from jaxtyping import Bool, Float, Int
from scipy import sparse
from scipy.sparse.linalg import splu
from scipy.spatial import KDTree

from jaxmocap.character import REQUIRED, Character, Pose, Skeleton, body_transforms
from jaxmocap.geometry import vertex_normals

from ._fit_template import Points
from ._weights import fewest, skin_weights, unwrung

_PRECISE = 8000  # triangles that weights are solved for; finer meshes take theirs from a simplified copy
_ALL_ELSE = ("spine", "thorax", "l_clavicle", "r_clavicle", "pelvis", "head")


def bind(
    name: str,
    vertices: Float[np.ndarray, "vertex 3"],
    faces: Int[np.ndarray, "face 3"],
    places: Mapping[str, np.ndarray],
    laid: Float[np.ndarray, "skin 3"],
) -> Character:
    """Bind a clean mesh in the rest frame (metres) to a skeleton and return the character.

    Joints and landmarks are at `places`, and the template's skin is `laid` into the mesh. Weights are by bone heat,
    wider where joints would turn the skin inside out.
    """
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


_ROUNDS = 10
_WIDTH = 0.04  # metres by which a round blurs the weights, and at least by the length of an edge
_AROUND = 0.02  # metres around a triangle that turned out, in which it does
_FINE = 0.01
_ENOUGH = 0.001  # share of triangles that may turn out without more ado


def widened(
    vertices: Float[np.ndarray, "vertex 3"],
    faces: Int[np.ndarray, "face 3"],
    weights: Float[np.ndarray, "vertex bone"],
    places: Mapping[str, np.ndarray],
    skeleton: Skeleton,
) -> Float[np.ndarray, "vertex bone"]:
    """Blur skinning weights around the triangles that turn inside out at a joint's limits; metres, rest frame.

    Bone heat blends two bones over a width that depends on how near they are, not on how far they may turn. Each round
    blurs more where it is still needed; the round is taken in which the worst limit turns the fewest triangles, and of
    equals the one that turns the fewest over all limits. Elsewhere the weights stay as they are.
    """
    limits = RangeOfMotion.of(skeleton)
    edge = float(np.linalg.norm(vertices[faces[:, 1]] - vertices[faces[:, 0]], axis=1).mean())
    wide, near = (_blur(vertices, faces, width) for width in (max(_WIDTH, edge), _AROUND))
    best, least = weights, (np.inf, np.inf)
    for number in range(_ROUNDS + 1):
        turned = limits.turned(vertices, faces, weights)
        score = (float(turned.mean(axis=1).max()), float(turned.mean()))
        if score < least:
            best, least = weights, score
        if least[0] <= _ENOUGH or number == _ROUNDS:
            break
        folded = np.zeros((len(vertices), 1))
        folded[faces[turned.any(axis=0)]] = 1.0
        share = np.clip(2.0 * near(folded), 0.0, 1.0)
        weights = fewest(unwrung(weights + share * (wide(weights) - weights), vertices, places))
    return best


def evened(
    vertices: Float[np.ndarray, "vertex 3"], faces: Int[np.ndarray, "face 3"], weights: Float[np.ndarray, "vertex bone"]
) -> Float[np.ndarray, "vertex bone"]:
    """Smooth weights carried over from another mesh: no steps are left between what came from here and from there."""
    return fewest(_blur(vertices, faces, _FINE)(weights))


def _blur(vertices: np.ndarray, faces: np.ndarray, width: float) -> Callable[[np.ndarray], np.ndarray]:
    """Spreading of values over the surface as heat spreads, by a Gaussian of this width in metres whatever the size of
    the triangles: one implicit step, `(M + width^2 / 2 L) x = M x_0`."""
    stiffness, mass = robust_laplacian.mesh_laplacian(vertices, faces.astype(np.int64))
    solve = splu((mass + 0.5 * width**2 * stiffness).tocsc()).solve
    area = sparse.diags(mass.diagonal())
    return lambda values: np.clip(solve(area @ values), 0.0, 1.0)


class RangeOfMotion(NamedTuple):
    """Where each limit of each joint angle, the others at rest, takes the bodies: rows are limits."""

    rotations: Float[np.ndarray, "limit bone 3 3"]
    translations: Float[np.ndarray, "limit bone 3"]

    @classmethod
    def of(cls, skeleton: Skeleton) -> "RangeOfMotion":
        """Collect both limits of every joint angle of a skeleton."""
        angles = jnp.concatenate([jnp.diag(skeleton.lower), jnp.diag(skeleton.upper)])
        there = jax.vmap(lambda row: body_transforms(skeleton, Pose(jnp.eye(4), row)))(angles)
        return cls(np.asarray(there[:, :, :3, :3], np.float64), np.asarray(there[:, :, :3, 3], np.float64))

    def turned(
        self,
        vertices: Float[np.ndarray, "vertex 3"],
        faces: Int[np.ndarray, "face 3"],
        weights: Float[np.ndarray, "vertex bone"],
    ) -> Bool[np.ndarray, "limit face"]:
        """Mark the triangles that face away from where their own bones turn them."""
        normals, of_face = _normals(vertices, faces), weights[faces].mean(axis=1)
        upright = (of_face[:, :, None] * normals[:, None, :]).reshape(len(faces), -1)
        points = (weights[:, :, None] * vertices[:, None, :]).reshape(len(vertices), -1)
        rows = []
        for rotations, translations in zip(self.rotations, self.translations, strict=True):
            turn = np.swapaxes(rotations, 1, 2).reshape(-1, 3)
            there = points @ turn + weights @ translations
            rows.append(np.einsum("fi,fi->f", _normals(there, faces), upright @ turn) < 0)
        return np.stack(rows)


def turned_out(character: Character) -> float:
    """Measure the largest share of a character's triangles that turn inside out at any limit of any joint: 0 to 1.

    Linear blend skinning (Eq. 1) folds the skin of an armpit or groin where the blend is too narrow.
    """
    parts = (np.asarray(part) for part in (character.vertices, character.faces, character.weights))
    return float(RangeOfMotion.of(character.skeleton).turned(*parts).mean(axis=1).max())


def _normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    p, q = (b - a).T, (c - a).T
    return np.stack([p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0]], axis=1)
