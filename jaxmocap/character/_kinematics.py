"""Forward kinematics and skinning (Eqs 1 and 2)."""

from collections.abc import Iterable
from functools import lru_cache
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxmocap.geometry import hat, matmul, rigid

from ._character import Character
from ._pose import Pose
from ._skeleton import Skeleton


class Chain(NamedTuple):
    """Rotations and translations, world from rest, of every body, and those just before every joint DoF."""

    rotations: Float[Array, "bone 3 3"]
    translations: Float[Array, "bone 3"]
    before_rotations: Float[Array, "dof 3 3"]
    before_translations: Float[Array, "dof 3"]


def chain(skeleton: Skeleton, pose: Pose) -> Chain:
    """The product of exponentials of Eq. 2, `T_i = T_root exp(theta_1 xi_1) exp(theta_2 xi_2) ...`, body by body.

    Revolute twists are exponentiated in Rodrigues' form `[R, (I - R) q]`, exact at zero. Bodies of equal depth in the
    tree are computed together.
    """
    w = hat(skeleton.axes)
    sine, cosine = jnp.sin(pose.angles)[:, None, None], jnp.cos(pose.angles)[:, None, None]
    eye = jnp.eye(3, dtype=skeleton.axes.dtype)
    turn = eye + sine * w + (1 - cosine) * matmul(w, w)
    shift = skeleton.origins - _apply(turn, skeleton.origins)
    schedule = _schedule(skeleton.parents, skeleton.dof_body)

    rotations = pose.root[None, :3, :3]
    translations = pose.root[None, :3, 3]
    before: list[tuple[Array, Array]] = []
    for level in schedule.levels:
        rotation, translation = rotations[level.parents], translations[level.parents]
        for dofs, has_dof in level.slots:
            before.append((rotation[has_dof], translation[has_dof]))
            moved = matmul(rotation[has_dof], turn[dofs])
            carried = _apply(rotation[has_dof], shift[dofs]) + translation[has_dof]
            if len(has_dof) == len(rotation):
                rotation, translation = moved, carried
            else:
                rotation = rotation.at[has_dof].set(moved)
                translation = translation.at[has_dof].set(carried)
        rotations = jnp.concatenate([rotations, rotation])
        translations = jnp.concatenate([translations, translation])
    before_rotations = jnp.concatenate([rotation for rotation, _ in before])[schedule.dof_order]
    before_translations = jnp.concatenate([translation for _, translation in before])[schedule.dof_order]
    order = schedule.body_order
    return Chain(rotations[order], translations[order], before_rotations, before_translations)


@jax.jit
def body_transforms(skeleton: Skeleton, pose: Pose) -> Float[Array, "bone 4 4"]:
    """World-from-rest transform of every body (Eq. 2); the identity at the rest pose. Metres."""
    bodies = chain(skeleton, pose)
    return rigid(bodies.rotations, bodies.translations)


@jax.jit
def skin(character: Character, pose: Pose) -> Float[Array, "vertex 3"]:
    """Linear blend skinning (Eq. 1), `v = (sum_i omega_i T_i) v0`: world positions of all vertices, metres."""
    return blend(character.skeleton, pose, character.vertices, character.weights)


@jax.jit
def blend(
    skeleton: Skeleton, pose: Pose, points: Float[Array, "point 3"], weights: Float[Array, "point bone"]
) -> Float[Array, "point 3"]:
    """Eq. 1 for any rest points with any weights.

    One matrix product: `sum_i omega_i T_i v0` is linear in the entries of all `T_i`, and its left factor does not
    depend on the pose, so a batch of poses shares it.
    """
    bodies = chain(skeleton, pose)
    ones = jnp.ones_like(points[:, :1])
    left = weights[:, :, None] * jnp.concatenate([points, ones], axis=-1)[:, None, :]
    transposed = jnp.swapaxes(bodies.rotations, -1, -2)
    right = jnp.concatenate([transposed, bodies.translations[:, None, :]], axis=1)
    return jnp.matmul(left.reshape(len(points), -1), right.reshape(-1, 3), precision="highest")


@jax.jit
def landmark_positions(skeleton: Skeleton, pose: Pose) -> Float[Array, "landmark 3"]:
    """World positions of the joints and other landmarks, in the order of `skeleton.landmark_names`, metres."""
    bodies = chain(skeleton, pose)
    index = _rows(skeleton.landmark_bodies)
    return _apply(bodies.rotations[index], skeleton.landmarks) + bodies.translations[index]


def _apply(rotations: Array, vectors: Array) -> Array:
    return jnp.sum(rotations * vectors[..., None, :], axis=-1)


def _rows(numbers: Iterable[int]) -> np.ndarray:
    """Row numbers for indexing: unsigned, so that XLA gets a plain gather without the wrap of negative indices."""
    return np.array(list(numbers), dtype=np.uint32)


class _Level(NamedTuple):
    parents: np.ndarray  # rows of the transforms computed so far, the root's first
    slots: tuple[tuple[np.ndarray, np.ndarray], ...]  # (DoFs, rows of this level they turn), from root to tip


class _Schedule(NamedTuple):
    levels: tuple[_Level, ...]
    body_order: np.ndarray
    dof_order: np.ndarray


@lru_cache(maxsize=16)
def _schedule(parents: tuple[int, ...], dof_body: tuple[int, ...]) -> _Schedule:
    """Bodies by depth, and per depth the DoFs that turn them first, second, third."""
    dofs_of = [[dof for dof, owner in enumerate(dof_body) if owner == body] for body in range(len(parents))]
    depth = [0] * len(parents)
    for body, parent in enumerate(parents):
        depth[body] = depth[parent] + 1 if parent >= 0 else 0
    row = {-1: 0}
    levels, dof_sequence = [], []
    for current in range(max(depth) + 1):
        bodies = [body for body in range(len(parents)) if depth[body] == current]
        parent_rows = _rows(row[parents[body]] for body in bodies)
        slots = []
        for slot in range(max(len(dofs_of[body]) for body in bodies)):
            turned = [i for i, body in enumerate(bodies) if len(dofs_of[body]) > slot]
            dofs = [dofs_of[bodies[i]][slot] for i in turned]
            dof_sequence += dofs
            slots.append((_rows(dofs), _rows(turned)))
        for body in bodies:
            row[body] = len(row)
        levels.append(_Level(parent_rows, tuple(slots)))
    body_order = _rows(row[body] for body in range(len(parents)))
    return _Schedule(tuple(levels), body_order, _rows(np.argsort(dof_sequence)))
