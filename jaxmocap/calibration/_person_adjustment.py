"""Bundle adjustment of static cameras, a person's joints over time, bone lengths, focal lengths and clocks."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.sparse import csr_array, vstack
from scipy.spatial.transform import Rotation

from ._levenberg_marquardt import Loss, factors, minimise
from ._person_scene import JOINTS, RIGID, Beliefs, Keypoints, Noise

_CAUCHY = 2.0  # standard deviations


class Rig(NamedTuple):
    """Static cameras.

    Attributes:
        cam_from_world: poses.
        focal: lengths, pixels.
        late: of the clocks against the first camera's, seconds; added to the known times.
    """

    cam_from_world: Float[np.ndarray, "camera 4 4"]
    focal: Float[np.ndarray, " camera"]
    late: Float[np.ndarray, " camera"]


class PersonFit(NamedTuple):
    """What the adjustment found.

    Attributes:
        rig: the cameras.
        points: the joints, NaN where fewer than two cameras see one.
        cost: squared standard deviations.
        covariance: of turn and shift of each camera but the first.
    """

    rig: Rig
    points: Float[np.ndarray, "frame joint 3"]
    cost: float
    covariance: Float[np.ndarray, "unknown unknown"]


class PersonProblem:
    """Residuals of keypoints, bones and beliefs, with their sparse Jacobian.

    Unknowns: the joints, then turn and shift of each camera but the first, logarithms of the focal lengths' factors,
    clocks, logarithms of the bones' lengths.
    """

    def __init__(
        self,
        seen: Keypoints,
        centre: Float[np.ndarray, "camera 2"],
        rig: Rig,
        points: Float[np.ndarray, "frame joint 3"],
        noise: Noise,
        beliefs: Beliefs,
    ):
        self.centre, self.rig, self.beliefs, weight = centre, rig, beliefs, noise.weight
        self.cameras = len(rig.focal)
        known = np.asarray(np.isfinite(points).all(-1))
        self.known, number = known, np.cumsum(known).reshape(known.shape) - 1
        self.camera, frame, joint = np.nonzero(seen.seen & known)
        self.point = number[frame, joint]
        self.pixels = seen.pixels[self.camera, frame, joint]
        self.velocity = seen.velocity[self.camera, frame, joint]
        self.lag = (seen.seconds - seen.seconds[:1])[self.camera, frame]
        self.sigma = noise.sigma[self.camera]
        ends, kinds, spreads = [], [], []
        for kind, bone in enumerate(RIGID.values()):
            for a, b in bone.ends:
                both = known[:, JOINTS.index(a)] & known[:, JOINTS.index(b)]
                ends.append(np.stack([number[both, JOINTS.index(a)], number[both, JOINTS.index(b)]], axis=1))
                kinds.append(np.full(len(ends[-1]), kind))
                spreads.append(np.full(len(ends[-1]), bone.spread))
        self.ends, self.kind, self.spread = np.concatenate(ends), np.concatenate(kinds), np.concatenate(spreads)
        start = points[known]
        counts = [start.size, 6 * (self.cameras - 1), self.cameras, self.cameras, len(RIGID)]
        self.first = np.cumsum(counts)  # joints come first, since their part of the normal equations is sparse
        self.size = int(self.first[-1])
        self.start = np.zeros(self.size)
        long = np.linalg.norm(start[self.ends[:, 0]] - start[self.ends[:, 1]], axis=1)
        for kind, name in enumerate(RIGID):
            mine = long[self.kind == kind]
            guess = np.median(mine) if len(mine) else beliefs.bones.get(name, (0.3, 1))[0]
            self.start[self.first[3] + kind] = np.log(guess)
        self.start[self.first[2] : self.first[3]] = rig.late
        self.start[: start.size] = start.ravel()
        self._priors()
        data = 2 * len(self.point) + len(self.ends)
        robust = np.arange(data + len(self.prior_value)) < data
        self.loss = Loss(
            lambda rows: float(
                weight * _CAUCHY**2 * np.sum(np.log1p(rows[:data] ** 2 / _CAUCHY**2)) + np.sum(rows[data:] ** 2)
            ),
            lambda rows: np.where(robust, weight / (1 + rows**2 / _CAUCHY**2), 1.0),
        )

    def _priors(self) -> None:
        """Make the rows of beliefs, which are linear in the unknowns: a matrix, and values that are subtracted."""
        beliefs, entries, values = self.beliefs, [], []

        def row(parts: list[tuple[int, float]], value: float) -> None:
            entries.extend((len(values), column, factor) for column, factor in parts)
            values.append(value)

        focal, late, bones = self.first[1:4]
        tight = 1e-5
        ratio = np.log(self.rig.focal / beliefs.focal)
        for camera in range(self.cameras):
            deviation = max(beliefs.focal_deviation[camera], tight)
            row([(focal + camera, 1 / deviation)], -ratio[camera] / deviation)
            row([(late + camera, 1 / (max(beliefs.late, 1e-7) if camera else 1e-7))], 0.0)
            if camera and beliefs.alike and beliefs.focal_deviation[[0, camera]].all():
                difference = ratio[0] - ratio[camera]
                row([(focal + camera, 1 / beliefs.alike), (focal, -1 / beliefs.alike)], difference / beliefs.alike)
        for kind, name in enumerate(RIGID):
            length, deviation = beliefs.bones.get(name, (0.3, 3.0))
            row([(bones + kind, 1 / deviation)], np.log(length) / deviation)
        rows, columns, shares = (np.array(part) for part in zip(*entries, strict=True))
        self.prior = csr_array((shares, (rows, columns)), shape=(len(values), self.size))
        self.prior_value = np.array(values)

    def rig_of(self, values: Float[np.ndarray, "unknown"]) -> Rig:
        """Move the first rig by the unknowns."""
        poses = self.rig.cam_from_world.copy()
        twists = values[self.first[0] : self.first[1]].reshape(-1, 6)
        poses[1:, :3] = Rotation.from_rotvec(twists[:, :3]).as_matrix() @ poses[1:, :3]
        poses[1:, :3, 3] += twists[:, 3:]
        focal = self.rig.focal * np.exp(values[self.first[1] : self.first[2]])
        return Rig(poses, focal, values[self.first[2] : self.first[3]])

    def _off(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray, Rig]:
        """Keypoints' errors in pixels, the points in the cameras' axes, and the cameras."""
        rig = self.rig_of(values)
        points = values[: self.first[0]].reshape(-1, 3)
        poses = rig.cam_from_world[self.camera]
        inside = np.einsum("nij,nj->ni", poses[:, :3, :3], points[self.point]) + poses[:, :3, 3]
        depth = np.maximum(inside[:, 2:], 1e-3)
        time = self.lag + rig.late[self.camera]
        seen = self.pixels - time[:, None] * self.velocity
        return (
            rig.focal[self.camera, None] * inside[:, :2] / depth + self.centre[self.camera] - seen,
            np.column_stack([inside[:, :2], depth]),
            rig,
        )

    def residuals(self, values: Float[np.ndarray, "unknown"], /) -> Float[np.ndarray, "row"]:
        """Compute the rows of keypoints, bones and beliefs, in standard deviations."""
        off, _, _ = self._off(values)
        points = values[: self.first[0]].reshape(-1, 3)
        long = np.linalg.norm(points[self.ends[:, 0]] - points[self.ends[:, 1]], axis=1)
        bones = (np.log(np.maximum(long, 1e-6)) - values[self.first[3] + self.kind]) / self.spread
        return np.concatenate([(off / self.sigma[:, None]).ravel(), bones, self.prior @ values - self.prior_value])

    def jacobian(self, values: Float[np.ndarray, "unknown"], /) -> csr_array:
        """Differentiate the residuals by the unknowns."""
        _, inside, rig = self._off(values)
        count, camera = len(self.point), self.camera
        x, y, z = inside.T
        focal = rig.focal[camera]
        by_inside = np.zeros((count, 2, 3))
        by_inside[:, 0, 0] = by_inside[:, 1, 1] = focal / z
        by_inside[:, 0, 2], by_inside[:, 1, 2] = -focal * x / z**2, -focal * y / z**2
        by_inside /= self.sigma[:, None, None]
        by_point = by_inside @ rig.cam_from_world[camera, :3, :3]
        shift = np.concatenate([np.zeros((1, 3)), values[self.first[0] : self.first[1]].reshape(-1, 6)[:, 3:]])
        turned = inside - shift[camera]
        by_turn = np.cross(turned[:, None], by_inside) @ _left_jacobian(values[self.first[0] : self.first[1]])[camera]
        twist = np.zeros((count, 2, 6))
        twist[:, :, :3], twist[:, :, 3:] = by_turn, by_inside
        by_focal = (focal / z)[:, None] * inside[:, :2] / self.sigma[:, None]
        by_late = self.velocity / self.sigma[:, None]
        row = np.arange(2 * count).reshape(count, 2)
        moving = camera > 0
        parts = [
            (
                twist[moving],
                row[moving][:, :, None],
                (self.first[0] + 6 * (camera[moving] - 1))[:, None, None] + np.arange(6),
            ),
            (by_focal, row, (self.first[1] + camera)[:, None]),
            (by_late, row, (self.first[2] + camera)[:, None]),
            (by_point, row[:, :, None], (3 * self.point)[:, None, None] + np.arange(3)),
        ]
        points = values[: self.first[0]].reshape(-1, 3)
        across = points[self.ends[:, 0]] - points[self.ends[:, 1]]
        along = across / np.maximum(np.sum(across**2, axis=1), 1e-12)[:, None] / self.spread[:, None]
        below = (2 * count + np.arange(len(self.ends)))[:, None]
        parts += [
            (along, below, 3 * self.ends[:, :1] + np.arange(3)),
            (-along, below, 3 * self.ends[:, 1:] + np.arange(3)),
            (-1 / self.spread[:, None], below, (self.first[3] + self.kind)[:, None]),
        ]
        entries = [np.broadcast_arrays(*part) for part in parts]
        data = np.concatenate([value.ravel() for value, _, _ in entries])
        rows = np.concatenate([value.ravel() for _, value, _ in entries])
        columns = np.concatenate([value.ravel() for _, _, value in entries])
        top = csr_array((data, (rows, columns)), shape=(2 * count + len(self.ends), self.size))
        return csr_array(vstack([top, self.prior]))


def _left_jacobian(twists: Float[np.ndarray, " value"]) -> Float[np.ndarray, "camera 3 3"]:
    """How each camera's turn changes with its rotation vector; the first camera's is held."""
    result: list[np.ndarray] = [np.eye(3)]
    for turn in twists.reshape(-1, 6)[:, :3]:
        angle = float(np.linalg.norm(turn))
        hat = np.cross(np.eye(3), turn)
        if angle < 1e-6:
            result.append(np.eye(3) + 0.5 * hat)
        else:
            a, b = (1 - np.cos(angle)) / angle**2, (angle - np.sin(angle)) / angle**3
            result.append(np.eye(3) + a * hat + b * hat @ hat)
    return np.array(result)


def adjust_person(
    seen: Keypoints,
    centre: Float[np.ndarray, "camera 2"],
    rig: Rig,
    points: Float[np.ndarray, "frame joint 3"],
    noise: Noise,
    beliefs: Beliefs,
    steps: int = 200,
    enough: float = 1e-6,
) -> PersonFit:
    """Find the most probable cameras, joints and bones, from `rig` and `points`; the first camera's pose is held.

    `centre` are the principal points. It ends after so many `steps`, or when one gains less than the share `enough`.
    """
    problem = PersonProblem(seen, centre, rig, points, noise, beliefs)
    found = minimise(problem, problem.start, problem.loss, steps, enough)
    joints = np.full(points.shape, np.nan)
    joints[problem.known] = found.values[: problem.first[0]].reshape(-1, 3)
    poses = np.arange(problem.first[0], problem.first[1])
    right = np.zeros((problem.size, len(poses)))
    right[poses] = np.eye(len(poses))
    covariance = factors(found.normal).solve(right)[poses]
    return PersonFit(problem.rig_of(found.values), joints, found.cost, covariance)
