"""What a motion may hold, and the sentences about what it may not."""

from typing import TYPE_CHECKING, Any

import numpy as np

from jaxmocap._results import InputError

if TYPE_CHECKING:
    from ._motion import Motion

STATUSES = ("ok", "doubtful", "lost")


def frozen(values: Any, dtype: Any) -> np.ndarray:
    """Copy values into a read-only array of this type."""
    try:
        array = np.array(values, dtype=dtype)
    except (TypeError, ValueError) as error:
        raise InputError(f"A motion's array cannot be read as {np.dtype(dtype).name} ({error}).") from error
    array.setflags(write=False)
    return array


def check_motion(motion: "Motion") -> None:
    """Raise `InputError` if the arrays of a motion do not agree, or hold what no motion has."""
    frames, joints = len(motion.frames), len(motion.joint_names)
    if frames == 0:
        raise InputError("A motion needs at least one frame; none were given.")
    expected = {"root": (frames, 4, 4), "angles": (frames, motion.character.skeleton.num_angles)}
    expected |= {"frames": (frames,), "timestamps": (frames,), "status": (frames,)}
    expected |= {"joints": (frames, joints, 3), "confidence": (frames, joints)}
    arrays: dict[str, np.ndarray] = {name: getattr(motion, name) for name in expected}
    for name, values in motion.energy.items():
        arrays[f"energy_{name}"], expected[f"energy_{name}"] = values, (frames,)
    if motion.covariance is not None:
        arrays["covariance"], expected["covariance"] = motion.covariance, (frames, joints, 3, 3)
    if motion.cameras is not None:
        arrays["cam_from_world"] = np.asarray(motion.cameras.cam_from_world)
        expected["cam_from_world"] = (len(motion.cameras.names), frames, 4, 4)
    for name, shape in expected.items():
        if arrays[name].shape != shape:
            raise InputError(f"The motion's {name} has shape {arrays[name].shape}; {shape} was expected.")
    for name in ("root", "angles", "timestamps", "joints", "confidence", "covariance", "cam_from_world"):
        if name in arrays and not np.isfinite(arrays[name]).all():
            where = np.argwhere(~np.isfinite(arrays[name]))[0]
            raise InputError(f"The motion's {name} holds a number that is not finite, at {tuple(map(int, where))}.")
    for name in ("frames", "timestamps"):
        if frames > 1 and not (np.diff(arrays[name]) > 0).all():
            raise InputError(f"The motion's {name} do not increase; every frame must come once, in order of time.")
    unknown = sorted(set(motion.status.tolist()) - set(STATUSES))
    if unknown:
        raise InputError(f"The motion's status holds {unknown[0]!r}; one of {', '.join(STATUSES)} was expected.")
    rotation = motion.root[:, :3, :3].astype(np.float64)
    drift = np.abs(rotation @ rotation.swapaxes(1, 2) - np.eye(3)).max(axis=(1, 2))
    last_row = np.abs(motion.root[:, 3] - [0, 0, 0, 1]).max(axis=1)
    broken = np.flatnonzero((drift > 1e-2) | (last_row > 1e-3) | (np.linalg.det(rotation) < 0))
    if len(broken):
        raise InputError(f"The motion's root at frame {motion.frames[broken[0]]} is not a rigid transform.")
    if motion.up not in ("x", "y", "z"):
        raise InputError(f"The motion's vertical axis is {motion.up!r}; 'x', 'y' or 'z' was expected.")
