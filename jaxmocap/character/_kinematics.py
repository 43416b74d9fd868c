"""Forward kinematics and skinning (Eqs 1 and 2), their derivative by the increment, and the Taylor update (Eq. 4)."""

from collections.abc import Iterable
from functools import lru_cache, partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, UInt32

from jaxmocap.geometry import hat, matmul, rigid

from ._character import Character
from ._pose import Pose, check_pose
from ._skeleton import Skeleton


class Chain(NamedTuple):
    """Rotations and translations, world from rest, of every body, and those just before every joint angle."""

    rotations: Float[Array, "bone 3 3"]
    translations: Float[Array, "bone 3"]
    before_rotations: Float[Array, "angle 3 3"]
    before_translations: Float[Array, "angle 3"]


def chain(skeleton: Skeleton, pose: Pose) -> Chain:
    """Multiply the exponentials of Eq. 2, `T_i = T_root exp(theta_1 xi_1) exp(theta_2 xi_2) ...`, joint by joint.

    Revolute twists are exponentiated in Rodrigues' form `[R, (I - R) q]`, exact at zero. A loop, so that the many
    programs that pose a body stay small: joint by joint on a CPU, and a third as long on an accelerator, which moves
    the joints of a level side by side. Raises `InputError` for a pose of another skeleton.
    """
    check_pose(skeleton, pose)
    w = hat(skeleton.axes)
    sine, cosine = jnp.sin(pose.angles)[:, None, None], jnp.cos(pose.angles)[:, None, None]
    eye = jnp.eye(3, dtype=skeleton.axes.dtype)
    turn = eye + sine * w + (1 - cosine) * matmul(w, w)
    shift = skeleton.origins - times(turn, skeleton.origins)
    steps = _steps(skeleton.parents, skeleton.dof_body, side_by_side=jax.default_backend() != "cpu")
    turn = jnp.concatenate([turn, eye[None]])[steps.dof]
    shift = jnp.concatenate([shift, jnp.zeros_like(shift[:1])])[steps.dof]

    def step(bodies: tuple[Array, Array], now: tuple[Array, ...]) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
        source, target, turn, shift = now
        rotation, translation = bodies[0][source], bodies[1][source]
        moved = bodies[0].at[target].set(matmul(rotation, turn))
        carried = bodies[1].at[target].set(times(rotation, shift) + translation)
        return (moved, carried), (rotation, translation)

    count = 1 + len(skeleton.parents)  # the root's transform comes first
    room = max(count, int(steps.target.max()) + 1)  # what no body has is written behind them
    start = (
        jnp.broadcast_to(pose.root[:3, :3], (room, 3, 3)).astype(turn.dtype),
        jnp.broadcast_to(pose.root[:3, 3], (room, 3)).astype(turn.dtype),
    )
    bodies, before = lax.scan(step, start, (jnp.asarray(steps.source), jnp.asarray(steps.target), turn, shift))
    joints = _rows(np.argsort(steps.dof.reshape(-1), kind="stable")[: len(skeleton.dof_body)])
    before = tuple(values.reshape(-1, *values.shape[steps.dof.ndim :])[joints] for values in before)
    return Chain(bodies[0][1:count], bodies[1][1:count], *before)


@jax.jit
def body_transforms(skeleton: Skeleton, pose: Pose) -> Float[Array, "bone 4 4"]:
    """Compute the world-from-rest transform of every body (Eq. 2), metres; the identity at the rest pose."""
    bodies = chain(skeleton, pose)
    return rigid(bodies.rotations, bodies.translations)


@jax.jit
def skin(character: Character, pose: Pose) -> Float[Array, "vertex 3"]:
    """Skin a mesh by linear blending (Eq. 1), `v = (sum_i omega_i T_i) v0`: world positions of all vertices, metres."""
    return blend(character.skeleton, pose, character.vertices, character.weights)


@jax.jit
def blend(
    skeleton: Skeleton, pose: Pose, points: Float[Array, "point 3"], weights: Float[Array, "point bone"]
) -> Float[Array, "point 3"]:
    """Apply Eq. 1 to any rest points with any weights.

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
    """Place the joints and other landmarks in the world, metres, in the order of `skeleton.landmark_names`."""
    bodies = chain(skeleton, pose)
    index = _rows(skeleton.landmark_bodies)
    return times(bodies.rotations[index], skeleton.landmarks) + bodies.translations[index]


@partial(jax.jit, static_argnames="carriers")
def offset_landmarks(
    skeleton: Skeleton, pose: Pose, offsets: Float[Array, "landmark 3"], carriers: tuple[int, ...]
) -> Float[Array, "landmark 3"]:
    """Place points that lie `offsets` away from the landmarks, metres in the rest frame, and turn with other bodies."""
    bodies = chain(skeleton, pose)
    index = _rows(skeleton.landmark_bodies)
    places = times(bodies.rotations[index], skeleton.landmarks) + bodies.translations[index]
    return places + times(bodies.rotations[_rows(carriers)], offsets)


def times(matrices: Float[Array, "*n 3 3"], vectors: Float[Array, "*n 3"]) -> Float[Array, "*n 3"]:
    """Multiply vectors by matrices, exactly on every device."""
    return jnp.sum(matrices * vectors[..., None, :], axis=-1)


def _rows(numbers: Iterable[int]) -> np.ndarray:
    """Row numbers for indexing: unsigned, so that XLA gets a plain gather without the wrap of negative indices."""
    return np.array(list(numbers), dtype=np.uint32)


class _Steps(NamedTuple):
    """Which transform each step takes (0 is the root), which one it makes, and the DoF that turns it; or those of the
    joints that a step moves side by side."""

    source: UInt32[np.ndarray, "step *joint"]
    target: UInt32[np.ndarray, "step *joint"]
    dof: UInt32[np.ndarray, "step *joint"]


@lru_cache(maxsize=16)
def _steps(parents: tuple[int, ...], dof_body: tuple[int, ...], side_by_side: bool) -> _Steps:
    """List one joint per joint DoF, parents before children, and one for every body without any.

    Side by side are those with as many joints before them; a step of fewer is filled up with what moves no body.
    """
    levels: list[list[tuple[int, int, int]]] = []
    depth = [0] * len(parents)
    for body, parent in enumerate(parents):
        depth[body] = depth[parent] + 1 if parent >= 0 else 0
    after = [0] * (len(parents) + 1)  # joints up to each transform
    for body in sorted(range(len(parents)), key=depth.__getitem__):
        source = parents[body] + 1
        for dof in [dof for dof, owner in enumerate(dof_body) if owner == body] or [len(dof_body)]:
            level, target = after[source], body + 1
            if not side_by_side or level == len(levels):
                levels.append([])
            levels[level if side_by_side else -1].append((source, target, dof))
            source, after[target] = target, level + 1
    if not side_by_side:
        return _Steps(*(_rows(column) for column in zip(*(step for (step,) in levels), strict=True)))
    nothing = (0, len(parents) + 1, len(dof_body))
    filled = [level + [nothing] * (max(map(len, levels)) - len(level)) for level in levels]
    return _Steps(*np.moveaxis(np.array(filled, np.uint32), 2, 0))


@jax.jit
def points_and_jacobian(
    skeleton: Skeleton, pose: Pose, points: Float[Array, "point 3"], weights: Float[Array, "point bone"]
) -> tuple[Float[Array, "point 3"], Float[Array, "point 3 dof"]]:
    """Skin points (Eq. 1) and differentiate them exactly by the increment of `retract`, at zero.

    Column of joint DoF j: `w'_j x u_j + s_j v'_j`, with `(v'_j, w'_j)` its twist carried to the current pose and `u_j`,
    `s_j` the sums of `omega_i T_i v0` and `omega_i` over the bodies i that j moves. Rest points (N, 3) in metres,
    weights (N, bone); a joint is a point with one weight of 1.
    """
    bodies = chain(skeleton, pose)
    carried = jnp.einsum("bij,nj->nbi", bodies.rotations, points, precision="highest") + bodies.translations
    weighted = weights[:, :, None] * carried
    moved = jnp.asarray(skeleton.moved_by(), points.dtype)
    positions = jnp.sum(weighted, axis=1)
    sums = jnp.einsum("db,nbi->ndi", moved, weighted, precision="highest")
    masses = jnp.matmul(weights, moved.T, precision="highest")

    angular = times(bodies.before_rotations, skeleton.axes)
    through = times(bodies.before_rotations, skeleton.origins) + bodies.before_translations
    linear = -jnp.cross(angular, through)
    joints = jnp.cross(angular[None], sums) + masses[:, :, None] * linear

    total = jnp.sum(weights, axis=1)[:, None]
    pelvis = jnp.sum(bodies.rotations[0] * skeleton.pelvis, axis=-1) + bodies.translations[0]
    translation = total[:, :, None] * jnp.eye(3, dtype=points.dtype)
    rotation = -hat(positions - total * pelvis)
    return positions, jnp.concatenate([translation, rotation, jnp.swapaxes(joints, 1, 2)], axis=2)
