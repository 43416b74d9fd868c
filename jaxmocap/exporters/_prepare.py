"""A motion as a format wants it: by angles from the neutral body, at a frame rate."""

import numpy as np
from jaxtyping import Float

from jaxmocap.character import angles_at_rest
from jaxmocap.motion import Motion, at_times

UPRIGHT = {"y": np.eye(3), "z": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])}
"""From the rest frame to a file's: all joints at zero stand upright in it."""
_EVEN = 0.01
"""Share of the time between two frames by which each may be off an even grid."""


def neutral_angles(motion: Motion) -> Float[np.ndarray, "frame angle"]:
    """Joint angles measured from the neutral body of the table of degrees of freedom, radians: the same for two actors
    in the same posture, whatever pose their meshes rest in."""
    return motion.angles + angles_at_rest(motion.character.skeleton)


def frame_rate_of(motion: Motion) -> float | None:
    """Frames per second, or None where the time between frames varies. A single frame counts as 30."""
    if len(motion) == 1:
        return 30.0
    even = np.linspace(motion.timestamps[0], motion.timestamps[-1], len(motion))
    interval = even[1] - even[0]
    return None if np.abs(motion.timestamps - even).max() > _EVEN * interval else float(1 / interval)


def resampled(motion: Motion, frame_rate: float) -> Motion:
    """The motion at even times from its first timestamp on, interpolated; frames count from 0."""
    if len(motion) == 1:
        return motion
    begin, end = motion.timestamps[[0, -1]]
    times = begin + np.arange(int(np.floor((end - begin) * frame_rate + 1e-6)) + 1) / frame_rate
    return at_times(motion, np.minimum(times, end))
