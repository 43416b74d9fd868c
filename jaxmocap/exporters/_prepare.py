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
_GAP = 1.75
"""Usual times between two frames: where it is as long, a frame is lacking."""
ORDERS = (("ZXY",), ("ZYX", "XYZ", "YXZ"), ("XZY", "YZX"))
"""Orders of axes: one that every program reads, those that most do, and the rest."""
_NEAR_LOCK = np.radians(70.0)  # of the middle angle
_LOCK = 1e-3  # radians from gimbal lock at which single precision no longer tells two angles apart


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


def mean_rate_of(motion: Motion) -> float:
    """Compute the frames per second of a motion of two frames or more, the mean over intervals that are no gaps."""
    steps = np.diff(motion.timestamps)
    return 1 / float(steps[steps < _GAP * np.median(steps)].mean())


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

    Of the two equivalent sets of angles, and of whole turns, each frame takes those nearest to the frame before. In
    gimbal lock, where only the sum of the first and last angle is known, the first one stays as before, or as after
    where the motion begins so.
    """
    rotations = Rotation.from_matrix(matrices)
    angles = _angles(rotations, order)
    locked = np.abs(np.sin(angles[:, 1]) if order[0] == order[2] else np.cos(angles[:, 1])) < _LOCK
    start = int(np.argmin(locked))  # the first frame that is not locked
    for frame in [*range(start + 1, len(angles)), *range(start - 1, -1, -1)]:
        before = angles[frame - 1 if frame > start else frame + 1]
        if locked[frame]:
            first = Rotation.from_euler(order[:2], [before[0], angles[frame, 1]])
            angles[frame, [0, 2]] = before[0], _about(order[2], first.inv() * rotations[frame])
        angles[frame] = _nearest(angles[frame], order, before)
    return angles


def euler_angles_near(
    matrices: Float[np.ndarray, "*n 3 3"], order: str, near: Float[np.ndarray, "*n 3"]
) -> Float[np.ndarray, "*n 3"]:
    """Decompose rotations as `euler_angles` does, each into the angles nearest to given ones."""
    angles = _angles(Rotation.from_matrix(matrices.reshape(-1, 3, 3)), order).reshape(matrices.shape[:-1])
    return _nearest(angles, order, near)


def _nearest(angles: np.ndarray, order: str, near: np.ndarray) -> np.ndarray:
    middle = -angles[..., 1] if order[0] == order[2] else np.pi - angles[..., 1]
    other = np.stack([angles[..., 0] + np.pi, middle, angles[..., 2] + np.pi], axis=-1)
    sets = [values - 2 * np.pi * np.round((values - near) / (2 * np.pi)) for values in (angles, other)]
    first, second = (np.abs(values - near).sum(axis=-1, keepdims=True) for values in sets)
    return np.where(first <= second, *sets)


def _about(axis: str, rotation: Rotation) -> float:
    """Measure a turn about x, y or z, radians."""
    x, y, z, w = rotation.as_quat()
    return float(2 * np.arctan2({"X": x, "Y": y, "Z": z}[axis], w))


def _angles(rotations: Rotation, order: str) -> np.ndarray:
    import warnings

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # in gimbal lock the third angle is 0: right, if not unique
        return rotations.as_euler(order)
