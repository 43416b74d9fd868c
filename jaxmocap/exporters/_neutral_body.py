"""The bodies as they lie in the neutral body: arms straight out to the sides, palms down, legs straight."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from jaxmocap.character import Skeleton, angles_at_rest

REST_FROM_OPENSIM = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
"""Turns OpenSim's x forward, y up, z right, which are ISB's, into our x left, y up, z forward."""


class NeutralBody(NamedTuple):
    """A skeleton with all of its table's angles at zero; places in metres, x left, y up, z forward.

    Attributes:
        turns: of each body the rotation from rest.
        joints: where each body's joint lies.
        axes: direction of each joint angle's axis.
        at_rest: the angles of the rest pose, radians.
    """

    turns: Float[np.ndarray, "bone 3 3"]
    joints: Float[np.ndarray, "bone 3"]
    axes: Float[np.ndarray, "angle 3"]
    at_rest: Float[np.ndarray, " angle"]

    def placed(self, skeleton: Skeleton, body: int, points: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
        """Move rest points of a body to where they lie in the neutral body."""
        return (points - skeleton.joints[body].astype(np.float64)) @ self.turns[body].T + self.joints[body]


def neutral_body(skeleton: Skeleton) -> NeutralBody:
    """Bend the skeleton out of its rest pose into the neutral body (Eq. 2, at minus the angles of the rest pose)."""
    at_rest, rest = angles_at_rest(skeleton), skeleton.joints.astype(np.float64)
    given = np.asarray(skeleton.axes, np.float64)
    turns, joints, axes = np.empty((len(rest), 3, 3)), rest.copy(), np.empty_like(given)
    for body, parent in enumerate(skeleton.parents):
        turn = np.eye(3) if parent < 0 else turns[parent]
        if parent >= 0:
            joints[body] = joints[parent] + turn @ (rest[body] - rest[parent])
        for angle in np.flatnonzero(np.array(skeleton.dof_body) == body):
            axis = given[angle] / np.linalg.norm(given[angle])
            axes[angle] = turn @ axis
            turn = turn @ Rotation.from_rotvec(-at_rest[angle] * axis).as_matrix()
        turns[body] = turn
    return NeutralBody(turns, joints, axes, at_rest)
