"""Joint angles that bring the bodies of a skeleton where the joints of a clip are."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float
from scipy.spatial.transform import Rotation

from jaxmocap.character import Pose, Skeleton, body_transforms, landmark_positions

_METRES, _RADIANS, _PULL = 0.01, 0.3, 100.0
"""What counts as one: of a bone's end, of a body's rotation, and of the distance to the start, which only decides what
the clip leaves open."""
_RIGHT_ANGLE = 1e-3
_CHUNK = 16
"""Frames solved by one call, so that clips of all lengths share a program."""


class Targets(NamedTuple):
    """What the bodies do in a clip.

    Attributes:
        rotations: world from rest, of the bodies; not finite where the clip does not know one.
        bones: names of the landmarks that each bone goes from and to.
        vectors: of the bones, in the world, metres.
    """

    rotations: Float[np.ndarray, "frame bone 3 3"]
    bones: tuple[tuple[str, str], ...]
    vectors: Float[np.ndarray, "frame segment 3"]


def joint_angles(
    skeleton: Skeleton, root: Float[np.ndarray, "frame 4 4"], targets: Targets
) -> Float[np.ndarray, "frame dof"]:
    """Solve for joint angles, radians, with given roots (least squares).

    Bones point where the clip's do, and bodies turn about them as far as their joints can follow. The start are the
    angles that follow the rotations body by body.
    """
    known = np.isfinite(targets.rotations[0]).all(axis=(1, 2))
    start = _body_by_body(skeleton, root, targets.rotations, known)
    index = [[skeleton.landmark_names.index(name) for name in bone] for bone in targets.bones]
    rows = jnp.asarray(np.array(index, np.uint32).reshape(-1, 2))
    bodies = jnp.asarray(np.flatnonzero(known).astype(np.uint32))
    wanted = (root, start, targets.rotations[:, known], targets.vectors)
    found = []
    for begin in range(0, len(root), _CHUNK):
        frames = np.minimum(np.arange(begin, begin + _CHUNK), len(root) - 1)
        chunk = tuple(jnp.asarray(values[frames], jnp.float32) for values in wanted)
        found.append(np.asarray(_solve(skeleton, rows, bodies, chunk)))
    return np.concatenate(found)[: len(root)]


@jax.jit
def _solve(skeleton: Skeleton, rows: Array, bodies: Array, wanted: tuple[Array, ...]) -> Float[Array, "frame dof"]:
    solver = optx.LevenbergMarquardt(rtol=1e-5, atol=1e-5, linear_solver=lx.Normal(lx.Cholesky()))

    def residual(angles: Array, frame: tuple[Array, ...]) -> tuple[Array, ...]:
        root, start, rotations, vectors = frame
        pose = Pose(root, angles)
        places = landmark_positions(skeleton, pose)
        turns = body_transforms(skeleton, pose)[bodies, :3, :3]
        return (
            (places[rows[:, 1]] - places[rows[:, 0]] - vectors) / _METRES,
            (turns - rotations) / _RADIANS,
            (angles - start) / _PULL,
        )

    def one(frame: tuple[Array, ...]) -> Array:
        return optx.least_squares(residual, solver, frame[1], args=frame, max_steps=64, throw=False).value

    return jax.lax.map(one, wanted)


def _body_by_body(
    skeleton: Skeleton, root: np.ndarray, rotations: np.ndarray, known: np.ndarray
) -> Float[np.ndarray, "frame dof"]:
    """Find, from the pelvis outwards, the angles of each body's joint that come nearest to its rotation."""
    axes = np.asarray(skeleton.axes, np.float64)
    angles = np.zeros((len(root), len(axes)))
    reached = np.tile(np.eye(3), (len(root), len(skeleton.parents), 1, 1))
    reached[:, 0] = root[:, :3, :3]
    for body, parent in list(enumerate(skeleton.parents))[1:]:
        dofs = [dof for dof, owner in enumerate(skeleton.dof_body) if owner == body]
        reached[:, body] = reached[:, parent]
        if not dofs:
            continue
        if known[body]:
            wanted = reached[:, parent].swapaxes(1, 2) @ rotations[:, body]
            angles[:, dofs] = _hinges(axes[dofs], wanted)
        for dof in dofs:
            turn = Rotation.from_rotvec(angles[:, dof, None] * axes[dof]).as_matrix()
            reached[:, body] = reached[:, body] @ turn
    return angles


def _hinges(axes: Float[np.ndarray, "dof 3"], wanted: Float[np.ndarray, "frame 3 3"]) -> Float[np.ndarray, "frame dof"]:
    """Find angles about one to three axes, one after the other, whose rotation is nearest to the wanted one."""
    if len(axes) == 3 and max(abs(axes[0] @ axes[1]), abs(axes[1] @ axes[2])) < _RIGHT_ANGLE:
        square = axes.copy()  # as exactly at right angles as the decomposition demands
        square[1] -= (square[1] @ square[0]) * square[0]
        square[1] /= np.linalg.norm(square[1])
        square[2] -= (square[2] @ square[1]) * square[1]
        square[2] /= np.linalg.norm(square[2])
        return np.asarray(Rotation.from_matrix(wanted).as_davenport(square, "intrinsic"))
    angles = np.zeros((len(wanted), len(axes)))
    for _ in range(1 if len(axes) == 1 else 30):
        for dof in range(len(axes)):
            before, after = np.eye(3), np.eye(3)
            for other in range(len(axes)):
                if other != dof:
                    turn = Rotation.from_rotvec(angles[:, other, None] * axes[other]).as_matrix()
                    before, after = (before @ turn, after) if other < dof else (before, after @ turn)
            # tr(W^T B exp(a) A) is largest where the turn that is left, B^T W A^T, is nearest to one about the axis.
            left = np.swapaxes(np.broadcast_to(before, wanted.shape), 1, 2) @ wanted
            left = left @ np.swapaxes(np.broadcast_to(after, wanted.shape), 1, 2)
            skew = np.stack(
                [left[:, 2, 1] - left[:, 1, 2], left[:, 0, 2] - left[:, 2, 0], left[:, 1, 0] - left[:, 0, 1]], axis=1
            )
            cosine = np.trace(left, axis1=1, axis2=2) - np.einsum("i,tij,j->t", axes[dof], left, axes[dof])
            angles[:, dof] = np.arctan2(skew @ axes[dof], cosine)
    return angles
