"""The pose, and the increments by which it moves."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxmocap.geometry import matmul, rigid, se3_exp, so3_exp, so3_log

from ._skeleton import ROOT_DOFS, Skeleton


class Pose(eqx.Module):
    """Where the body is and how it is bent: `root` is world_from_body (identity at rest), `angles` in radians.

    Both may carry the same leading batch axes under `vmap`.
    """

    root: Float[Array, "*batch 4 4"]
    angles: Float[Array, "*batch angle"]


def rest_pose(skeleton: Skeleton) -> Pose:
    """The pose the mesh was made in: identity root, zero angles."""
    dtype = skeleton.axes.dtype
    return Pose(root=jnp.asarray(np.eye(4), dtype), angles=jnp.zeros(skeleton.num_angles, dtype))


def pelvis_position(skeleton: Skeleton, pose: Pose) -> Float[Array, "3"]:
    """World position of the pelvis, metres."""
    return jnp.sum(pose.root[:3, :3] * skeleton.pelvis, axis=-1) + pose.root[:3, 3]


@jax.jit
def retract(skeleton: Skeleton, pose: Pose, delta: Float[Array, " dof"]) -> Pose:
    """Move a pose by an increment, one number per degree of freedom.

    `delta[0:3]` translates the pelvis in the world (metres), `delta[3:6]` is a world rotation vector applied on the
    left about the pelvis (radians), `delta[6:]` adds to the joint angles. Departs from Eq. 2's root twist about the
    world origin, which couples rotation with translation when the origin is far away; `retract_root_twist` is the
    literal reading.
    """
    rotation = matmul(so3_exp(delta[3:6]), pose.root[:3, :3])
    pelvis = pelvis_position(skeleton, pose) + delta[:3]
    translation = pelvis - jnp.sum(rotation * skeleton.pelvis, axis=-1)
    return Pose(root=rigid(rotation, translation), angles=pose.angles + delta[ROOT_DOFS:])


def retract_root_twist(pose: Pose, delta: Float[Array, " dof"]) -> Pose:
    """Eq. 2 to the letter: the root moves by the world twist `delta[0:6] = (v, w)` about the world origin."""
    return Pose(root=matmul(se3_exp(delta[:ROOT_DOFS]), pose.root), angles=pose.angles + delta[ROOT_DOFS:])


@jax.jit
def difference(skeleton: Skeleton, a: Pose, b: Pose) -> Float[Array, " dof"]:
    """The increment from `a` to `b`: `retract(skeleton, a, difference(skeleton, a, b))` is `b`."""
    translation = pelvis_position(skeleton, b) - pelvis_position(skeleton, a)
    rotation = so3_log(matmul(b.root[:3, :3], a.root[:3, :3].T))
    return jnp.concatenate([translation, rotation, b.angles - a.angles])


def pose_vector(skeleton: Skeleton, pose: Pose) -> Float[Array, " dof"]:
    """A pose as one number per degree of freedom: its increment from the rest pose."""
    return difference(skeleton, rest_pose(skeleton), pose)


def pose_from_vector(skeleton: Skeleton, vector: Float[Array, " dof"]) -> Pose:
    """The pose of such numbers; the inverse of `pose_vector`."""
    return retract(skeleton, rest_pose(skeleton), vector)


def clamp(skeleton: Skeleton, pose: Pose) -> Pose:
    """The pose with its joint angles clipped to the skeleton's limits; the root is free."""
    return Pose(root=pose.root, angles=jnp.clip(pose.angles, skeleton.lower, skeleton.upper))


def with_limb(pose: Pose, limb: Pose, dofs: tuple[int, ...], share: float = 1.0) -> Pose:
    """A pose whose angles `dofs` are moved by a share of the way to those of another one."""
    index = jnp.array(dofs) - ROOT_DOFS
    here = pose.angles[index]
    return Pose(pose.root, pose.angles.at[index].set(here + share * (limb.angles[index] - here)))
