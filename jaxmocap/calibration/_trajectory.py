"""A camera's path over time: poses that leave it are found, and those that are missing interpolated.

Repeated texture puts single images far from their place with a small residual, so residuals cannot find them; a hand,
however it shakes, moves a camera only centimetres from frame to frame.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial.transform import Rotation, Slerp

from jaxmocap.geometry import camera_centres

_REACHES = (3, 7)  # poses on either side that predict one: near ones exactly, far ones past a run of wrong ones
_DEGREE = 2
_TIMES_USUAL = 8.0  # standard deviations of the path beyond which a pose is off it
_SMALLEST_SHIFT = 0.003  # of the distance to the scene
_SMALLEST_TURN = np.radians(0.4)
MAD_TO_SIGMA = 1.4826


class Departures(NamedTuple):
    """How far each pose is from what its neighbours in time predict.

    Attributes:
        shift: of the centre, in units of the distance to the scene.
        turn: angle, radians.
        outlier: whether it is off the path.
        usual_shift: robust standard deviation of `shift` over the path.
        usual_turn: that of `turn`, radians.
    """

    shift: Float[np.ndarray, " pose"]
    turn: Float[np.ndarray, " pose"]
    outlier: Bool[np.ndarray, " pose"]
    usual_shift: float
    usual_turn: float


def find_outliers(
    times: Float[np.ndarray, " pose"], cam_from_world: Float[np.ndarray, "pose 4 4"], distance: float
) -> Departures:
    """Find poses that lie off the path of the others. `distance` to the scene, in the poses' units, sets the scale.

    Each pose is compared with parabolas through its three and its seven neighbours on either side, fitted with absolute
    values: the first follow a hand's shake ten times more closely, the second are not bent by five wrong poses.
    The worst are taken out, round by round, until none remain; `shift` and `turn` are those of the first.
    """
    count = len(times)
    outlier = np.zeros(count, bool)
    shift, turn, usual_shift, usual_turn = np.zeros(count), np.zeros(count), 0.0, 0.0
    for _ in range(12):
        excess = np.zeros(count)
        for reach in reversed(_REACHES):
            shift, turn = _departures(times, cam_from_world, ~outlier, reach)
            shift = shift / distance
            usual_shift, usual_turn = (_spread(values[~outlier]) for values in (shift, turn))
            excess = np.maximum(excess, shift / max(_TIMES_USUAL * usual_shift, _SMALLEST_SHIFT))
            excess = np.maximum(excess, turn / max(_TIMES_USUAL * usual_turn, _SMALLEST_TURN))
        now = excess > np.maximum(1.0, 0.3 * excess[~outlier].max(initial=0.0))
        now |= outlier & (excess > 1.0)
        if (now == outlier).all():
            break
        outlier = now
    return Departures(shift, turn, outlier, usual_shift, usual_turn)


def _spread(values: np.ndarray) -> float:
    """Robust standard deviation of lengths about zero."""
    return MAD_TO_SIGMA * float(np.median(values)) if len(values) else 0.0


def _departures(times: np.ndarray, poses: np.ndarray, trusted: np.ndarray, reach: int) -> tuple[np.ndarray, np.ndarray]:
    """Distance of every pose from the path its trusted neighbours make, the pose itself left out."""
    predicted = np.array(poses, np.float64)
    for index in range(len(times)):
        neighbours = _neighbours(index, trusted, reach)
        if len(neighbours) >= 3:
            predicted[index] = _predict(times[index], times[neighbours], poses[neighbours])
    shift = np.linalg.norm(camera_centres(poses) - camera_centres(predicted), axis=1)
    relative = poses[:, :3, :3] @ predicted[:, :3, :3].transpose(0, 2, 1)
    return shift, Rotation.from_matrix(relative).magnitude()


def _neighbours(index: int, trusted: np.ndarray, reach: int) -> Int[np.ndarray, " neighbour"]:
    usable = np.flatnonzero(trusted)
    before, after = usable[usable < index][-reach:], usable[usable > index][:reach]
    return np.concatenate([before, after])


def _predict(time: float, times: np.ndarray, poses: np.ndarray) -> np.ndarray:
    """Predict the pose at `time` by robust parabolas through centres and rotation vectors."""
    rotations = poses[:, :3, :3]
    alike = np.einsum("aij,bij->ab", rotations, rotations)
    middle = rotations[int(np.median(alike, axis=1).argmax())]  # the most central, so that rotation vectors are small
    values = np.concatenate([camera_centres(poses), Rotation.from_matrix(rotations @ middle.T).as_rotvec()], axis=1)
    offset = (times - time) / max(np.abs(times - time).max(), 1e-9)
    degree = _DEGREE if min((offset < 0).sum(), (offset > 0).sum()) >= 2 else 1
    value = np.concatenate([_robust_value_at_zero(offset, part, degree) for part in (values[:, :3], values[:, 3:])])
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_rotvec(value[3:]).as_matrix() @ middle
    pose[:3, 3] = -pose[:3, :3] @ value[:3]
    return pose


def _robust_value_at_zero(offset: np.ndarray, values: np.ndarray, degree: int) -> np.ndarray:
    """Polynomial of least summed distance (iteratively reweighted), at offset 0; begun from the median, which a
    minority of wrong values cannot move far."""
    basis = np.vander(offset, degree + 1, increasing=True)
    away = np.linalg.norm(values - np.median(values, axis=0), axis=1)
    for _ in range(10):
        weight = 1 / np.maximum(away, 1e-9 + 1e-3 * np.median(away))
        weighted = basis * (weight / weight.max())[:, None]
        ridge = 1e-12 * np.eye(degree + 1)  # neighbours of weight near zero may leave too few
        coefficients = np.linalg.solve(weighted.T @ basis + ridge, weighted.T @ values)
        away = np.linalg.norm(values - basis @ coefficients, axis=1)
    return coefficients[0]


def interpolate(
    times: Float[np.ndarray, " pose"],
    cam_from_world: Float[np.ndarray, "pose 4 4"],
    known: Bool[np.ndarray, " pose"],
) -> Float[np.ndarray, "pose 4 4"]:
    """Replace the poses that are not `known` by interpolation between their neighbours that are.

    Centres are interpolated linearly, rotations on the shortest arc; before the first and after the last known pose the
    nearest one is held. Raises `ValueError` when none is known.
    """
    if not known.any():
        raise ValueError("no pose is known")
    result = np.array(cam_from_world, np.float64)
    inside = np.clip(times, times[known][0], times[known][-1])
    rotations = Rotation.from_matrix(result[known, :3, :3])
    turned = Slerp(times[known], rotations)(inside).as_matrix() if known.sum() > 1 else rotations.as_matrix()
    places = camera_centres(result[known])
    centres = np.stack([np.interp(inside, times[known], places[:, axis]) for axis in range(3)], axis=1)
    result[~known, :3, :3] = np.broadcast_to(turned, result[:, :3, :3].shape)[~known]
    result[~known, :3, 3] = -np.einsum("nij,nj->ni", result[~known, :3, :3], centres[~known])
    return result
