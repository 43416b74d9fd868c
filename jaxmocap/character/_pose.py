"""The pose, the increments by which it moves, and the two sets of angles of every ball joint.

For unit axes `u`, `v`, `w` of three hinges through one point with `v` at right angles to both others, and `c` the angle
from `w` to `u` about `v`, `exp(a u) exp(b v) exp(d w) = exp((a + pi) u) exp((2 c - b) v) exp((d + pi) w)`: the half
turns about `u` and `w` meet in a rotation about `v` by twice the angle between them. The joint limits cut both sets, so
that a search that holds on to one of them may be walled in where the other one has room.
"""

import math
from collections.abc import Sequence
from functools import lru_cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxmocap._shapes import check_shape
from jaxmocap.geometry import matmul, rigid, so3_exp, so3_log

from ._skeleton import ROOT_DOFS, Skeleton


class Pose(eqx.Module):
    """Where the body is and how it is bent: `root` is world_from_body (identity at rest), `angles` in radians.

    Both may carry the same leading batch axes under `vmap`.
    """

    root: Float[Array, "*batch 4 4"]
    angles: Float[Array, "*batch angle"]


def check_pose(skeleton: Skeleton, pose: Pose) -> None:
    """Raise `InputError` unless this is one pose of this skeleton."""
    many = "map over several poses with jax.vmap"
    check_shape("pose.root", pose.root, (4, 4), many)
    check_shape("pose.angles", pose.angles, (skeleton.num_angles,), f"one per angle of the skeleton; {many}")


def rest_pose(skeleton: Skeleton) -> Pose:
    """Make the pose the mesh was made in: identity root, zero angles."""
    dtype = skeleton.axes.dtype
    return Pose(root=jnp.asarray(np.eye(4), dtype), angles=jnp.zeros(skeleton.num_angles, dtype))


def pelvis_position(skeleton: Skeleton, pose: Pose) -> Float[Array, "3"]:
    """Compute the world position of the pelvis, metres."""
    return jnp.sum(pose.root[:3, :3] * skeleton.pelvis, axis=-1) + pose.root[:3, 3]


@jax.jit
def retract(skeleton: Skeleton, pose: Pose, delta: Float[Array, " dof"]) -> Pose:
    """Move a pose by an increment, one number per degree of freedom.

    `delta[0:3]` translates the pelvis in the world (metres), `delta[3:6]` is a world rotation vector applied on the
    left about the pelvis (radians), `delta[6:]` adds to the joint angles. Departs from Eq. 2's root twist about the
    world origin, which couples rotation with translation when the origin is far away. Raises `InputError` for an
    increment of another length.
    """
    check_pose(skeleton, pose)
    check_shape("the increment", delta, (skeleton.num_dofs,), "six of the root, then one per angle of the skeleton")
    rotation = matmul(so3_exp(delta[3:6]), pose.root[:3, :3])
    pelvis = pelvis_position(skeleton, pose) + delta[:3]
    translation = pelvis - jnp.sum(rotation * skeleton.pelvis, axis=-1)
    return Pose(root=rigid(rotation, translation), angles=pose.angles + delta[ROOT_DOFS:])


@jax.jit
def difference(skeleton: Skeleton, a: Pose, b: Pose) -> Float[Array, " dof"]:
    """Compute the increment from `a` to `b`: `retract(skeleton, a, difference(skeleton, a, b))` is `b`."""
    translation = pelvis_position(skeleton, b) - pelvis_position(skeleton, a)
    rotation = so3_log(matmul(b.root[:3, :3], a.root[:3, :3].T))
    return jnp.concatenate([translation, rotation, b.angles - a.angles])


def pose_vector(skeleton: Skeleton, pose: Pose) -> Float[Array, " dof"]:
    """Write a pose as one number per degree of freedom: its increment from the rest pose."""
    return difference(skeleton, rest_pose(skeleton), pose)


def pose_from_vector(skeleton: Skeleton, vector: Float[Array, " dof"]) -> Pose:
    """Build the pose from such numbers; the inverse of `pose_vector`."""
    return retract(skeleton, rest_pose(skeleton), vector)


def clamp(skeleton: Skeleton, pose: Pose) -> Pose:
    """Clip a pose's joint angles to the skeleton's limits; the root is free."""
    return Pose(root=pose.root, angles=jnp.clip(pose.angles, skeleton.lower, skeleton.upper))


def with_limb(pose: Pose, limb: Pose, dofs: tuple[int, ...], share: float = 1.0) -> Pose:
    """Move the angles `dofs` of a pose a share of the way to those of another one (host)."""
    index = np.array(dofs) - ROOT_DOFS
    angles, there = np.array(pose.angles), np.asarray(limb.angles)[index]
    angles[index] += np.float32(share) * (there - angles[index])
    return Pose(pose.root, jax.device_put(angles))


_RIGHT_ANGLE = 1e-3


def ball_joints(skeleton: Skeleton) -> list[tuple[slice, float]]:
    """List the angles of each ball joint, and `2 c` (host)."""
    axes, origins = np.asarray(skeleton.axes, np.float64), np.asarray(skeleton.origins, np.float64)
    return list(_ball_joints(axes.tobytes(), origins.tobytes(), skeleton.dof_body))


@lru_cache(maxsize=16)
def _ball_joints(axes_bytes: bytes, origins_bytes: bytes, dof_body: tuple[int, ...]) -> tuple[tuple[slice, float], ...]:
    axes, origins = (np.frombuffer(values).reshape(-1, 3) for values in (axes_bytes, origins_bytes))
    found = []
    for first in range(len(axes) - 2):
        place = slice(first, first + 3)
        u, v, w = axes[place]
        one_body = len(set(dof_body[place])) == 1
        one_point = np.allclose(origins[place], origins[first], atol=1e-6)
        if one_body and one_point and max(abs(u @ v), abs(v @ w)) < _RIGHT_ANGLE:
            found.append((place, 2 * math.atan2(np.cross(w, u) @ v, u @ w)))
    return tuple(found)


def equivalent_angles(
    angles: Float[np.ndarray, "3"], twice: float, lower: Float[np.ndarray, "3"], upper: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "3"]:
    """Find the other angles of the same rotation, by whole turns as near to the middle of the limits as can be."""
    other = np.array([angles[0] + math.pi, twice - angles[1], angles[2] + math.pi])
    return other - 2 * math.pi * np.round((other - 0.5 * (lower + upper)) / (2 * math.pi))


def away_from_limits(skeleton: Skeleton, pose: Pose, gain: float = math.radians(10.0)) -> Pose:
    """Write each ball joint by those of its two sets of angles that are farther from the joint limits (host).

    The pose stays the same; the set changes only where that wins `gain` radians.
    """
    angles = np.array(pose.angles)
    for place, twice in ball_joints(skeleton):
        lower, upper = (np.asarray(limit)[place] for limit in (skeleton.lower, skeleton.upper))
        other = equivalent_angles(angles[place], twice, lower, upper)
        room = [np.minimum(values - lower, upper - values).min() for values in (angles[place], other)]
        if room[1] > max(room[0] + gain, 0.0):
            angles[place] = other
    return Pose(pose.root, jnp.asarray(angles))


def rewritten_increments(
    skeleton: Skeleton, before: Pose, after: Pose, increments: Sequence[Float[np.ndarray, " dof"]]
) -> list[Float[np.ndarray, " dof"]]:
    """Write increments that led to `before` as those of `after`, the same pose by other angles (host).

    In the other set of a ball joint's angles the middle one goes the other way.
    """
    angles, again = np.asarray(before.angles), np.asarray(after.angles)
    signs = np.ones(skeleton.num_dofs, np.float32)
    for place, _ in ball_joints(skeleton):
        if np.cos(again[place.start] - angles[place.start]) < 0:  # half a turn apart
            signs[ROOT_DOFS + place.start + 1] = -1
    return list(increments) if (signs > 0).all() else [signs * increment for increment in increments]


def nearest_equivalent(skeleton: Skeleton, pose: Pose, target: Pose) -> Pose:
    """Write each ball joint by those angles that are nearer to the ones of `target` (host); the pose stays the same."""
    angles, wanted = np.array(pose.angles), np.asarray(target.angles)
    for place, twice in ball_joints(skeleton):
        other = equivalent_angles(angles[place], twice, wanted[place], wanted[place])
        if np.abs(other - wanted[place]).sum() < np.abs(angles[place] - wanted[place]).sum():
            angles[place] = other
    return Pose(pose.root, jnp.asarray(angles))
