"""How much of a character's skin turns inside out where its joints are at their limits."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from jaxmocap.character import Character, Pose, Skeleton, body_transforms


class RangeOfMotion(NamedTuple):
    """Where each limit of each joint angle, the others at rest, takes the bodies: rows are limits."""

    rotations: Float[np.ndarray, "limit bone 3 3"]
    translations: Float[np.ndarray, "limit bone 3"]

    @classmethod
    def of(cls, skeleton: Skeleton) -> "RangeOfMotion":
        """The 66 limits of a skeleton."""
        angles = jnp.concatenate([jnp.diag(skeleton.lower), jnp.diag(skeleton.upper)])
        there = jax.vmap(lambda row: body_transforms(skeleton, Pose(jnp.eye(4), row)))(angles)
        return cls(np.asarray(there[:, :, :3, :3], np.float64), np.asarray(there[:, :, :3, 3], np.float64))

    def turned(
        self,
        vertices: Float[np.ndarray, "vertex 3"],
        faces: Int[np.ndarray, "face 3"],
        weights: Float[np.ndarray, "vertex bone"],
    ) -> Bool[np.ndarray, "limit face"]:
        """Which triangles face away from where their own bones turn them."""
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
    """The largest share of a character's triangles that turn inside out at any limit of any joint: 0 to 1.

    Linear blend skinning (Eq. 1) folds the skin of an armpit or groin where the blend is too narrow.
    """
    parts = (np.asarray(part) for part in (character.vertices, character.faces, character.weights))
    return float(RangeOfMotion.of(character.skeleton).turned(*parts).mean(axis=1).max())


def _normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    p, q = (b - a).T, (c - a).T
    return np.stack([p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0]], axis=1)
