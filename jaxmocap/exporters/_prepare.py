"""A motion as a format wants it: angles from the neutral body, Euler angles that do not jump, at a frame rate."""

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from jaxmocap.character import angles_at_rest
from jaxmocap.motion import Motion, at_times

UPRIGHT = {"y": np.eye(3), "z": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])}
"""From the rest frame to a file's: all joints at zero stand upright in it."""
_EVEN = 0.01
"""Share of the time between two frames by which each may be off an even grid."""
ORDERS = (("ZXY",), ("ZYX", "XYZ", "YXZ"), ("XZY", "YZX"))
"""Orders of axes: one that every program reads, those that most do, and the rest."""
_NEAR_LOCK = np.radians(70.0)  # of the middle angle


def neutral_angles(motion: Motion) -> Float[np.ndarray, "frame angle"]:
    """Measure joint angles from the neutral body of the table of degrees of freedom, radians.

    They are the same for two actors in the same posture, whatever pose their meshes rest in.
    """
    return motion.angles + angles_at_rest(motion.character.skeleton)


def frame_rate_of(motion: Motion) -> float | None:
    """Tell the frames per second; None where the time between frames varies. A single frame counts as 30."""
    if len(motion) == 1:
        return 30.0
    even = np.linspace(motion.timestamps[0], motion.timestamps[-1], len(motion))
    interval = even[1] - even[0]
    return None if np.abs(motion.timestamps - even).max() > _EVEN * interval else float(1 / interval)


def resampled(motion: Motion, frame_rate: float) -> Motion:
    """Interpolate a motion at even times from its first timestamp on; frames count from 0."""
    if len(motion) == 1:
        return motion
    begin, end = motion.timestamps[[0, -1]]
    times = begin + np.arange(int(np.floor((end - begin) * frame_rate + 1e-6)) + 1) / frame_rate
    return at_times(motion, np.minimum(times, end))


def best_order(matrices: Float[np.ndarray, "frame 3 3"]) -> str:
    """Choose the order of turning whose middle angle stays farthest from gimbal lock.

    That is a quarter turn, at which the other two axes fall together. A more common order is taken wherever it keeps 20
    degrees away from it.
    """
    rotations = Rotation.from_matrix(matrices)
    reach: dict[str, float] = {}
    for orders in ORDERS:
        reach |= {order: float(np.abs(_angles(rotations, order)[:, 1]).max()) for order in orders}
        best = min(reach, key=reach.__getitem__)
        if reach[best] < _NEAR_LOCK:
            break
    return best


def euler_angles(matrices: Float[np.ndarray, "frame 3 3"], order: str) -> Float[np.ndarray, "frame 3"]:
    """Decompose rotations into radians about the axes of `order`, each axis turned by the ones before it: R = R1 R2 R3.

    Of the two equivalent sets of angles, and of whole turns, each frame takes those nearest to the frame before.
    """
    angles = _angles(Rotation.from_matrix(matrices), order)
    for frame in range(1, len(angles)):
        before, now = angles[frame - 1], angles[frame]
        equivalent = np.array([now[0] + np.pi, np.pi - now[1], now[2] + np.pi])
        near = [values - 2 * np.pi * np.round((values - before) / (2 * np.pi)) for values in (now, equivalent)]
        angles[frame] = min(near, key=lambda values: np.abs(values - before).sum())
    return angles


def _angles(rotations: Rotation, order: str) -> np.ndarray:
    import warnings

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # in gimbal lock the third angle is 0: right, if not unique
        return rotations.as_euler(order)
