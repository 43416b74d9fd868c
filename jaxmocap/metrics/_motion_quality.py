"""What a motion shows of itself, without a truth: feet that slide while they stand, accelerations, jitter."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from jaxmocap.motion import STRIDE, Motion, evened

FEET = ("left", "right")
_POINTS = ("heel", "toe")
_LOW = 5  # percentile of a point's heights that counts as the ground: a frame that was lost must not lower it


@dataclass(frozen=True)
class FootSkate:
    """Horizontal speed of the left and the right foot from each frame to the next, m/s; NaN where it does not stand."""

    speed: Float[np.ndarray, "interval foot"]

    def summary(self) -> dict[str, float]:
        """Summarise the intervals in which a foot stands, mean and 95th percentile in m/s; empty if none does."""
        known = self.speed[np.isfinite(self.speed)]
        return {"mean": float(known.mean()), "p95": float(np.percentile(known, 95))} if known.size else {}


def foot_skate(motion: Motion, height: float = 0.025) -> FootSkate:
    """Measure how fast feet slide while they stand.

    A foot stands from one frame to the next while its heel, or its toe, stays within `height` metres of the ground,
    which lies where that point is at its lowest; of two such points the slower one counts, so that a foot may turn on
    its heel or roll over its toe. Over a gap in which a foot may have stepped nothing is known.

    The threshold of height is that of Zhang et al., Mode-Adaptive Neural Networks for Quadruped Motion Control (2018),
    who weigh speeds by height where we count them or do not. The ground is taken to be level. Dancers slide on purpose:
    a large value is a reason to look, not an error. Without heels and toes nothing is known.
    """
    if not {f"{side[0]}_{point}" for side in FEET for point in _POINTS} <= set(motion.joint_names):
        return FootSkate(np.full((max(len(motion) - 1, 0), len(FEET)), np.nan))
    up = "xyz".index(motion.up)
    names = [[motion.joint_names.index(f"{side[0]}_{point}") for point in _POINTS] for side in FEET]
    places = motion.joints[:, names].astype(np.float64)  # frame, foot, point, 3
    heights = places[..., up]
    stands = heights < np.percentile(heights, _LOW, axis=0) + height
    apart = np.diff(evened(motion.timestamps))[:, None, None]
    stands = stands[1:] & stands[:-1] & (apart <= STRIDE)
    steps = np.delete(np.diff(places, axis=0), up, axis=-1) / apart[..., None]
    speeds = np.where(stands, np.linalg.norm(steps, axis=-1), np.inf).min(axis=-1)
    return FootSkate(np.where(np.isfinite(speeds), speeds, np.nan))


def accelerations(
    positions: Float[np.ndarray, "frame joint 3"], timestamps: Float[np.ndarray, " frame"]
) -> Float[np.ndarray, "inner joint 3"]:
    """Take second divided differences at inner frames, m/s^2; frames need not be evenly spaced.

    What a container rounded of the times of an even rate is taken out: at 60 frames a second, whole milliseconds make
    5 m/s^2 of an even walk.
    """
    if len(positions) < 3:
        return np.zeros((0, *positions.shape[1:]))
    interval = np.diff(evened(timestamps))[:, None, None]
    velocity = np.diff(positions, axis=0) / interval
    return 2 * np.diff(velocity, axis=0) / (interval[1:] + interval[:-1])


def jitter(motion: Motion, scale: float = 1.0) -> dict[str, float]:
    """Summarise the joints' accelerations, mean and 95th percentile in m/s^2, in a world of `scale` metres per unit.

    Less is smoother, not better: `JointErrors.acceleration` compares with the truth.
    """
    values = scale * np.linalg.norm(accelerations(motion.joints.astype(np.float64), motion.timestamps), axis=-1)
    if values.size == 0:
        return {"mean": 0.0, "p95": 0.0}
    return {"mean": float(values.mean()), "p95": float(np.percentile(values, 95))}
