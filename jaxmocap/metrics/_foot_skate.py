"""Foot skate: how fast feet slide while they stand. "Near the ground" is that of Zhang et al., Mode-Adaptive Neural
Networks for Quadruped Motion Control (2018), who weigh speeds by height where we count them or do not."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from jaxmocap.motion import Motion

FEET = ("left", "right")
_POINTS = ("heel", "toe")
_LOW = 5  # percentile of a point's heights that counts as the ground: a frame that was lost must not lower it


@dataclass(frozen=True)
class FootSkate:
    """Horizontal speed of the left and the right foot from each frame to the next, m/s; NaN where it does not stand."""

    speed: Float[np.ndarray, "interval foot"]

    def summary(self) -> dict[str, float]:
        """Mean and 95th percentile over the intervals in which a foot stands, m/s; empty if none does."""
        known = self.speed[np.isfinite(self.speed)]
        return {"mean": float(known.mean()), "p95": float(np.percentile(known, 95))} if known.size else {}


def foot_skate(motion: Motion, height: float = 0.025) -> FootSkate:
    """Foot skate of a motion. A foot stands from one frame to the next while its heel, or its toe, stays within
    `height` metres of the ground, which lies where that point is at its lowest; of two such points the slower one
    counts, so that a foot may turn on its heel or roll over its toe.

    The ground is taken to be level. Dancers slide on purpose: a large value is a reason to look, not an error.
    """
    up = 1 if motion.up == "y" else 2
    names = [[motion.joint_names.index(f"{side[0]}_{point}") for point in _POINTS] for side in FEET]
    places = motion.joints[:, names].astype(np.float64)  # frame, foot, point, 3
    heights = places[..., up]
    stands = heights < np.percentile(heights, _LOW, axis=0) + height
    stands = stands[1:] & stands[:-1]
    steps = np.delete(np.diff(places, axis=0), up, axis=-1) / np.diff(motion.timestamps)[:, None, None, None]
    speeds = np.where(stands, np.linalg.norm(steps, axis=-1), np.inf).min(axis=-1)
    return FootSkate(np.where(np.isfinite(speeds), speeds, np.nan))
