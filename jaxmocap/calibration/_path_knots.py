"""Slow corrections of a camera's path: small twists at knots in time, straight lines between them."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation


class Knots(NamedTuple):
    """For each pose the two knots it lies between, numbered over all cameras, and the `share` of the second.
    `neighbours` are pairs of knots of one camera that follow each other."""

    count: int
    pairs: Int[np.ndarray, "pose 2"]
    share: Float[np.ndarray, " pose"]
    neighbours: Int[np.ndarray, "pair 2"]

    def at_poses(self, twists: Float[np.ndarray, "knot 6"]) -> Float[np.ndarray, "pose 6"]:
        first, second = twists[self.pairs[:, 0]], twists[self.pairs[:, 1]]
        return (1 - self.share[:, None]) * first + self.share[:, None] * second


def place_knots(camera: Int[np.ndarray, " pose"], seconds: Float[np.ndarray, " pose"], apart: float) -> Knots:
    """Knots at most `apart` seconds from each other over the span of each camera's poses; two for one at least."""
    pairs, share, neighbours = np.zeros((len(camera), 2), int), np.zeros(len(camera)), []
    count = 0
    for one in np.unique(camera):
        mine = np.flatnonzero(camera == one)
        first, last = seconds[mine].min(), seconds[mine].max()
        spans = max(1, int(np.ceil((last - first) / apart - 1e-9)))
        place = (seconds[mine] - first) / max(last - first, 1e-9) * spans
        lower = np.minimum(place.astype(int), spans - 1)
        pairs[mine] = count + lower[:, None] + [0, 1]
        share[mine] = place - lower
        neighbours += [(count + k, count + k + 1) for k in range(spans)]
        count += spans + 1
    return Knots(count, pairs, share, np.array(neighbours))


def moved(cam_from_world: Float[np.ndarray, "pose 4 4"], twist: Float[np.ndarray, "pose 6"]) -> np.ndarray:
    """Poses after a turn (rotation vector) and then a shift, both in the camera's axes."""
    turn = Rotation.from_rotvec(twist[:, :3]).as_matrix()
    result = np.array(cam_from_world, np.float64)
    result[:, :3] = turn @ cam_from_world[:, :3]
    result[:, :3, 3] += twist[:, 3:]
    return result
