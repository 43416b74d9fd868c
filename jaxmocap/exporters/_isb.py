"""Joint angles as the International Society of Biomechanics recommends them, from a motion."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.spatial.transform import Rotation

from jaxmocap._results import InputError
from jaxmocap.character import Pose, Skeleton, body_transforms, points_and_jacobian, retract
from jaxmocap.motion import Motion

from ._isb_joints import MIDDLE, SIDES, IsbJoint
from ._neutral_body import REST_FROM_OPENSIM, neutral_body
from ._prepare import euler_angles, euler_angles_near

_MIRROR = np.diag([1.0, 1.0, -1.0])
_HANDS = {"upper_arm", "forearm", "hand"}
_STEP = 0.01  # radians and metres, of a derivative
_FREE_ROOT, _FREE_ANGLE = 0.3, 0.8  # deviations that nothing tells, as of a tracked pose: metres and radians
_MOST = 180.0  # degrees
_MOVED = 0.05  # degrees per degree of the pose, below which an angle is the tilt of another's axis
_FRAMES = 32  # whose derivatives are taken at once


class IsbAngles(NamedTuple):
    """Angles of the joints that a skeleton has, in the order of `joints`, three each.

    Attributes:
        joints: with their sides in their names.
        names: of the angles.
        degrees: of each frame and angle.
        confidence: of each frame and angle, in [0, 1].
        deviations: standard deviations in degrees, NaN for an angle that the tracked joint does not turn by; None where
            the motion does not know its uncertainty.
    """

    joints: tuple[IsbJoint, ...]
    names: tuple[str, ...]
    degrees: Float[np.ndarray, "frame angle"]
    confidence: Float[np.ndarray, "frame angle"]
    deviations: Float[np.ndarray, "frame angle"] | None


def isb_angles(motion: Motion) -> IsbAngles:
    """Compute the ISB joint angles of a motion whose world is y up, without jumps.

    The confidence is the least of those of the landmarks that define the joint. The standard deviation is that of the
    pose which the covariances of the landmarks leave, their errors taken as independent: first order, at most 180.
    Raises `InputError` for a skeleton that has none of these joints.
    """
    skeleton = motion.character.skeleton
    joints = _joints_of(skeleton)
    if not joints:
        raise InputError(
            f"the character {motion.character.name} has none of a person's joints that ISB angles are of (its joints "
            f"are {', '.join(skeleton.joint_names)}); write a .csv, which has the skeleton's own angles."
        )
    turns = _relative(skeleton, joints, motion.body_transforms[..., :3, :3], motion.angles)
    degrees = np.concatenate([_angles_of(joint, turns[:, number]) for number, joint in enumerate(joints)], axis=1)
    seen = [[motion.joint_names.index(name) for name in joint.seen_by] for joint in joints]
    confidence = np.stack([motion.confidence[:, own].min(axis=1) for own in seen for _ in range(3)], axis=1)
    names = tuple(f"{joint.name}_{angle}" for joint in joints for angle in joint.angles)
    deviations = None if motion.covariance is None else _deviations(motion, joints, degrees)
    return IsbAngles(joints, names, degrees, confidence.astype(np.float64), deviations)


def _joints_of(skeleton: Skeleton) -> tuple[IsbJoint, ...]:
    """List the joints whose bodies and landmarks the skeleton has, with their sides."""
    found = list(MIDDLE)
    for side in "lr":
        for joint in SIDES:
            if joint.name == "wrist" and f"{side}_wrist_flex" not in skeleton.angle_names:
                continue
            bodies = [
                name if name in ("pelvis", "chest") else f"{side}_{name}" for name in (joint.proximal, joint.distal)
            ]
            seen_by = tuple(f"{side}_{name}" for name in joint.seen_by)
            found.append(
                joint._replace(name=f"{side}_{joint.name}", proximal=bodies[0], distal=bodies[1], seen_by=seen_by)
            )
    bodies, landmarks = {"", *skeleton.body_names}, set(skeleton.landmark_names)
    return tuple(one for one in found if {one.proximal, one.distal} <= bodies and set(one.seen_by) <= landmarks)


def _relative(
    skeleton: Skeleton, joints: tuple[IsbJoint, ...], rotations: Float[np.ndarray, "n bone 3 3"], angles: np.ndarray
) -> Float[np.ndarray, "n joint 3 3"]:
    """Turn each distal segment's ISB axes into its proximal one's, mirrored to the right side of the body."""
    neutral, segments = neutral_body(skeleton), {"": np.broadcast_to(np.eye(3), (len(rotations), 3, 3))}
    for number, name in enumerate(skeleton.body_names):
        side, part = (name[:2], name[2:]) if name[:2] in ("l_", "r_") else ("", name)
        turn, rest = rotations[:, number].astype(np.float64), neutral.turns[number]
        pronation = f"{side}forearm_pron"
        if part == "forearm" and pronation in skeleton.angle_names:
            angle = skeleton.angle_names.index(pronation)
            axis = np.asarray(skeleton.axes, np.float64)[angle]
            turn = turn @ Rotation.from_rotvec(angles[:, angle, None] * axis).as_matrix()
            rest = rest @ Rotation.from_rotvec(-neutral.at_rest[angle] * axis).as_matrix()
        hanging = np.eye(3)
        if part in _HANDS:
            hanging = Rotation.from_euler("z", -90 if side == "l_" else 90, degrees=True).as_matrix()
        own = rest.T @ hanging.T @ REST_FROM_OPENSIM
        if part in ("forearm", "hand"):  # hanging, the palms face the thighs: a quarter turn from palms forward
            own = own @ Rotation.from_euler("y", -90 if side == "l_" else 90, degrees=True).as_matrix()
        segments[name] = turn @ own
    turns = [segments[joint.proximal].swapaxes(1, 2) @ segments[joint.distal] for joint in joints]
    turns = [
        _MIRROR @ turn @ _MIRROR if joint.name.startswith("l_") else turn
        for joint, turn in zip(joints, turns, strict=True)
    ]
    return np.stack(turns, axis=1)


def _angles_of(joint: IsbJoint, turns: Float[np.ndarray, "frame 3 3"]) -> Float[np.ndarray, "frame 3"]:
    """Decompose a joint's rotations into degrees that do not jump, as near to 0 as whole turns allow."""
    angles = euler_angles(turns, joint.order)
    if joint.order[0] == joint.order[2] and np.mean(angles[:, 1]) > 0:  # an elevation is negative about its axis
        angles = angles * [1, -1, 1] + [np.pi, 0, np.pi]
    angles -= 2 * np.pi * np.round(np.mean(angles, axis=0) / (2 * np.pi))
    return np.degrees(angles * joint.signs)


def _deviations(
    motion: Motion, joints: tuple[IsbJoint, ...], degrees: Float[np.ndarray, "frame angle"]
) -> Float[np.ndarray, "frame angle"]:
    """Carry the landmarks' covariances to the pose, and from there to the angles, first order."""
    skeleton, found = motion.character.skeleton, []
    steepest = np.zeros(degrees.shape[1])
    weights = jnp.eye(len(skeleton.body_names))[np.array(skeleton.landmark_bodies)]
    steps = _STEP * np.concatenate([np.eye(skeleton.num_dofs), -np.eye(skeleton.num_dofs)])
    signs = np.array([joint.signs for joint in joints])
    free = skeleton.per_dof(_FREE_ROOT, _FREE_ANGLE).astype(np.float64)
    for first in range(0, len(motion), _FRAMES):
        part = slice(first, first + _FRAMES)
        poses = Pose(jax.device_put(motion.root[part]), jax.device_put(motion.angles[part]))
        moves, rotations, angles = (
            np.asarray(array, np.float64) for array in _moved(skeleton, poses, weights, jnp.asarray(steps, jnp.float32))
        )
        spread = motion.covariance[part].astype(np.float64) + 1e-10 * np.eye(3)  # pyright: ignore[reportOptionalSubscript]
        information = np.einsum("tjad,tjae->tde", moves, np.linalg.solve(spread, moves)) + np.diag(free**-2.0)
        count = len(rotations)
        turns = _relative(
            skeleton, joints, rotations.reshape(-1, *rotations.shape[2:]), angles.reshape(-1, angles.shape[-1])
        ).reshape(count, len(steps), len(joints), 3, 3)
        base = np.radians(degrees[part]).reshape(count, len(joints), 3) * signs
        slopes = np.empty((count, len(steps), len(joints), 3))
        for number, joint in enumerate(joints):
            near = np.broadcast_to(base[:, None, number], slopes.shape[:2] + (3,))
            slopes[:, :, number] = euler_angles_near(turns[:, :, number], joint.order, near)
        slopes = slopes.reshape(count, 2, skeleton.num_dofs, -1)
        slopes = (slopes[:, 0] - slopes[:, 1]) / (2 * _STEP)
        steepest = np.maximum(steepest, np.abs(slopes).max(axis=(0, 1)))
        variances = np.einsum("tda,tda->ta", slopes, np.linalg.solve(information, slopes))
        found.append(np.minimum(np.degrees(np.sqrt(np.maximum(variances, 0))), _MOST))
    return np.where(steepest > _MOVED, np.concatenate(found), np.nan)


@jax.jit
def _moved(
    skeleton: Skeleton, poses: Pose, weights: Float[Array, "landmark bone"], steps: Float[Array, "step dof"]
) -> tuple[Array, Array, Array]:
    """Differentiate the landmarks by the pose, and move every pose by every step."""

    def one(pose: Pose) -> tuple[Array, Array, Array]:
        _, moves = points_and_jacobian(skeleton, pose, skeleton.landmarks, weights)
        moved = jax.vmap(lambda step: retract(skeleton, pose, step))(steps)
        return moves, jax.vmap(lambda other: body_transforms(skeleton, other))(moved)[..., :3, :3], moved.angles

    return jax.lax.map(one, poses)
