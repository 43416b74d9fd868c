"""A motion in a world with another vertical axis."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np

from ._motion import Motion

_Y_FROM_Z = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])


def turned(motion: Motion, up: str) -> Motion:
    """The same motion in a world whose vertical axis is `up`; x stays."""
    if up == motion.up:
        return motion
    turn = np.eye(4)
    turn[:3, :3] = _Y_FROM_Z if up == "y" else _Y_FROM_Z.T
    cameras = motion.cameras
    if cameras is not None:
        cameras = replace(cameras, cam_from_world=jnp.asarray(np.asarray(cameras.cam_from_world, float) @ turn.T))
    covariance = motion.covariance
    if covariance is not None:
        covariance = turn[:3, :3] @ covariance @ turn[:3, :3].T
    return replace(
        motion,
        root=turn @ motion.root,
        joints=motion.joints @ turn[:3, :3].T,
        cameras=cameras,
        up=up,
        covariance=covariance,
    )
