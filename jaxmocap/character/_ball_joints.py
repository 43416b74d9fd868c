"""Joints of three hinges: every rotation has two sets of angles.

For unit axes `u`, `v`, `w` through one point with `v` at right angles to both others, and `c` the angle from `w` to `u`
about `v`, `exp(a u) exp(b v) exp(d w) = exp((a + pi) u) exp((2 c - b) v) exp((d + pi) w)`: the half turns about `u` and
`w` meet in a rotation about `v` by twice the angle between them. The joint limits cut both sets, so that a search that
holds on to one of them may be walled in where the other one has room.
"""

import math

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ._pose import Pose
from ._skeleton import Skeleton

_RIGHT_ANGLE = 1e-3


def ball_joints(skeleton: Skeleton) -> list[tuple[slice, float]]:
    """The angles of each ball joint, and `2 c` (host)."""
    axes, origins = np.asarray(skeleton.axes, np.float64), np.asarray(skeleton.origins)
    found = []
    for first in range(skeleton.num_angles - 2):
        place = slice(first, first + 3)
        u, v, w = axes[place]
        one_body = len(set(skeleton.dof_body[place])) == 1
        one_point = np.allclose(origins[place], origins[first], atol=1e-6)
        if one_body and one_point and max(abs(u @ v), abs(v @ w)) < _RIGHT_ANGLE:
            found.append((place, 2 * math.atan2(np.cross(w, u) @ v, u @ w)))
    return found


def twin_angles(
    angles: Float[np.ndarray, "3"], twice: float, lower: Float[np.ndarray, "3"], upper: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "3"]:
    """The other angles of the same rotation, by whole turns as near to the middle of the limits as can be."""
    other = np.array([angles[0] + math.pi, twice - angles[1], angles[2] + math.pi])
    return other - 2 * math.pi * np.round((other - 0.5 * (lower + upper)) / (2 * math.pi))


def away_from_limits(skeleton: Skeleton, pose: Pose, gain: float = math.radians(10.0)) -> Pose:
    """The same pose, each ball joint by those of its two sets of angles that are farther from the joint limits; the
    set changes only when that wins `gain` radians (host)."""
    angles = np.array(pose.angles)
    for place, twice in ball_joints(skeleton):
        lower, upper = (np.asarray(limit)[place] for limit in (skeleton.lower, skeleton.upper))
        other = twin_angles(angles[place], twice, lower, upper)
        room = [np.minimum(values - lower, upper - values).min() for values in (angles[place], other)]
        if room[1] > max(room[0] + gain, 0.0):
            angles[place] = other
    return Pose(pose.root, jnp.asarray(angles))


def nearest_equivalent(skeleton: Skeleton, pose: Pose, target: Pose) -> Pose:
    """The same pose, each ball joint by those angles that are nearer to the ones of `target` (host)."""
    angles, wanted = np.array(pose.angles), np.asarray(target.angles)
    for place, twice in ball_joints(skeleton):
        other = twin_angles(angles[place], twice, wanted[place], wanted[place])
        if np.abs(other - wanted[place]).sum() < np.abs(angles[place] - wanted[place]).sum():
            angles[place] = other
    return Pose(pose.root, jnp.asarray(angles))
