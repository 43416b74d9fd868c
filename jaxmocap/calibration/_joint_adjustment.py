"""Bundle adjustment of cameras, their clocks, the background and the body together (Triggs et al. 2000).

Levenberg and Marquardt's method on the normal equations, reduced to the cameras' unknowns by the Schur complement over
the points; Cauchy's loss by reweighting.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy import linalg, sparse

from ._joint_scene import JointScene, JointState, Knots, place_knots, predict

_CHUNK = 2000  # points that are eliminated at a time
_CAUCHY = 2.0  # standard deviations
_ITERATIONS = 60
_ENOUGH = 0.05  # decrease of the cost, which is in squared standard deviations


class JointPriors(NamedTuple):
    """Standard deviations of what is believed beforehand; zero holds what it is about.

    Attributes:
        turn: of a camera from where it was, radians; 1 degree by default.
        shift: of a camera from where it was, metres; 0.05 by default.
        turn_between: of one knot from the next, radians; 0.2 degrees by default.
        shift_between: of one knot from the next, metres; 0.01 by default.
        apart: time between knots, seconds, no deviation; 1/3 by default.
        focal: of a focal length, relative; 0.005 by default.
        late: of a clock, seconds; by default 0.05, some two frames.
        body: of a body point from its tracked place, metres; 0.1 by default.
    """

    turn: float = float(np.radians(1.0))
    shift: float = 0.05
    turn_between: float = float(np.radians(0.2))
    shift_between: float = 0.01
    apart: float = 1 / 3
    focal: float = 0.005
    late: float = 0.05
    body: float = 0.1


class Adjusted(NamedTuple):
    """What the adjustment found.

    Attributes:
        knots: of the corrections of the paths.
        state: the unknowns.
        deviation: their standard deviations.
        cost: before and after, squared standard deviations.
    """

    knots: Knots
    state: JointState
    deviation: JointState
    cost: tuple[float, float]


def adjust_together(
    scene: JointScene,
    priors: JointPriors | None = None,
    start: JointState | None = None,
) -> Adjusted:
    """Find the most probable cameras, clocks and points, from `start` where given.

    The first camera's clock is held, and so is what no prior lets go.
    """
    priors = JointPriors() if priors is None else priors
    knots, state = unadjusted(scene, priors.apart)
    state = state if start is None else start
    cost = before = _cost(scene, knots, state, priors)
    damping, system = 1e-4, _System(scene, knots, state, priors)
    for _ in range(_ITERATIONS):
        trial = system.step(damping)
        now = _cost(scene, knots, trial, priors)
        if now >= cost:
            damping *= 10
            if damping > 1e6:
                break
            continue
        small = cost - now < max(_ENOUGH, 1e-6 * cost)
        state, cost, damping = trial, now, max(damping / 5, 1e-9)
        system = _System(scene, knots, state, priors)
        if small:
            break
    return Adjusted(knots, state, system.deviation(), (before, cost))


def unadjusted(scene: JointScene, apart: float) -> tuple[Knots, JointState]:
    """Place knots `apart` seconds from each other, with the state in which everything is as it was."""
    knots, cameras = place_knots(scene.camera, scene.seconds, apart), len(scene.focal)
    return knots, JointState(np.zeros((knots.count, 6)), np.zeros(cameras), np.zeros(cameras), scene.points.copy())


def _cost(scene: JointScene, knots: Knots, state: JointState, priors: JointPriors) -> float:
    error = (predict(scene, knots, state).pixels - scene.pixels) / scene.sigma[:, None]
    square = np.sum(error**2, axis=1)
    total = _CAUCHY**2 * np.sum(np.log1p(square / _CAUCHY**2))
    total += np.sum(((state.points - scene.points)[: scene.num_body] / priors.body) ** 2)
    matrix, _ = _prior_rows(knots, len(state.late), priors)
    return float(total + np.sum((matrix @ _vector(state)) ** 2))


def _vector(state: JointState) -> np.ndarray:
    return np.concatenate([state.twists.ravel(), state.log_focal, state.late])


def _prior_rows(knots: Knots, cameras: int, priors: JointPriors) -> tuple[sparse.csr_array, np.ndarray]:
    """Build the rows of the priors, which should be zero, and tell which of the cameras' unknowns are free."""

    def inverse(*values: float) -> np.ndarray:
        return np.repeat([1 / value if value > 0 else 0.0 for value in values], 3)

    own = np.concatenate(
        [
            np.tile(inverse(priors.turn, priors.shift), knots.count),
            np.full(cameras, 1 / priors.focal if priors.focal else 0.0),
            np.full(cameras, 1 / priors.late if priors.late else 0.0),
        ]
    )
    free = own > 0
    free[6 * knots.count + cameras] = False
    size, pairs = len(own), len(knots.neighbours)
    rows = np.arange(6 * pairs).reshape(pairs, 6)
    weight = np.tile(inverse(priors.turn_between, priors.shift_between), (pairs, 1))
    entries = [
        ((sign * weight).ravel(), rows.ravel(), (6 * knots.neighbours[:, side, None] + np.arange(6)).ravel())
        for side, sign in ((0, -1.0), (1, 1.0))
    ]
    values, at, columns = (np.concatenate(part) for part in zip(*entries, strict=True))
    between = sparse.csr_array((values, (at, columns)), shape=(6 * pairs, size))
    return sparse.csr_array(sparse.vstack([sparse.diags_array(own), between])), free


class _System:
    """The normal equations at a state, the points taken out."""

    def __init__(self, scene: JointScene, knots: Knots, state: JointState, priors: JointPriors):
        self.scene, self.knots, self.state = scene, knots, state
        cameras, points = len(state.late), len(state.points)
        prior, self.free = _prior_rows(knots, cameras, priors)
        seen = predict(scene, knots, state)
        error = (seen.pixels - scene.pixels) / scene.sigma[:, None]
        root = np.sqrt(1 / (1 + np.sum(error**2, axis=1) / _CAUCHY**2))
        error = (root[:, None] * error).ravel()
        scale = (root / scene.sigma)[:, None, None]
        by_camera, columns, by_point = _derivatives(scene, knots, state)
        size, rows = 6 * knots.count + 2 * cameras, np.arange(len(error)).reshape(-1, 2)
        at = np.broadcast_to(columns[:, None], by_camera.shape)
        camera_rows = sparse.csr_array(
            ((scale * by_camera).ravel(), (np.broadcast_to(rows[..., None], at.shape).ravel(), at.ravel())),
            shape=(len(error), size),
        )
        by_point = scale * by_point
        at = np.broadcast_to((3 * scene.point_of[:, None] + np.arange(3))[:, None], by_point.shape)
        point_rows = sparse.csc_array(
            (by_point.ravel(), (np.broadcast_to(rows[..., None], at.shape).ravel(), at.ravel())),
            shape=(len(error), 3 * points),
        )
        self.normal = (camera_rows.T @ camera_rows + prior.T @ prior).toarray()
        self.slope = camera_rows.T @ error + prior.T @ (prior @ _vector(state))
        self.mixed = sparse.csc_array(camera_rows.T @ point_rows)
        self.blocks = np.zeros((points, 3, 3))
        np.add.at(self.blocks, scene.point_of, np.einsum("nki,nkj->nij", by_point, by_point))
        self.point_slope = (point_rows.T @ error).reshape(points, 3)
        body = slice(0, scene.num_body)
        self.blocks[body] += np.eye(3) / priors.body**2
        self.point_slope[body] += (state.points - scene.points)[body] / priors.body**2

    def _reduced(self, damping: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Reduce to the cameras: their matrix and right side, and the inverse blocks of the points."""
        diagonal = np.einsum("nii->ni", self.blocks)
        floor = damping * diagonal + 1e-9 * diagonal.max(axis=1, keepdims=True) + 1e-12
        inverse = np.linalg.inv(self.blocks + floor[:, :, None] * np.eye(3))
        matrix, right = self.normal + damping * np.diag(np.diag(self.normal)), -self.slope.copy()
        for begin in range(0, len(inverse), _CHUNK):
            part = slice(begin, begin + _CHUNK)
            mixed = self.mixed[:, 3 * begin : 3 * (begin + _CHUNK)].toarray()
            half = np.einsum("cpi,pij->cpj", mixed.reshape(len(mixed), -1, 3), inverse[part]).reshape(mixed.shape)
            matrix -= half @ mixed.T
            right += half @ self.point_slope[part].ravel()
        return matrix[np.ix_(self.free, self.free)], right[self.free], inverse

    def step(self, damping: float) -> JointState:
        matrix, right, inverse = self._reduced(damping)
        change = np.zeros(len(self.free))
        change[self.free] = linalg.solve(matrix, right, assume_a="sym")
        back = (self.mixed.T @ change).reshape(-1, 3) + self.point_slope
        state = self._state(_vector(self.state) + change)
        return state._replace(points=self.state.points - np.einsum("pij,pj->pi", inverse, back))

    def deviation(self) -> JointState:
        matrix, _, inverse = self._reduced(0.0)
        values = np.zeros(len(self.free))
        values[self.free] = np.sqrt(np.maximum(np.diag(linalg.inv(matrix)), 0))
        return self._state(values)._replace(points=np.sqrt(np.maximum(np.einsum("nii->ni", inverse), 0)))

    def _state(self, vector: Float[np.ndarray, " unknown"]) -> JointState:
        twists, cameras = 6 * self.knots.count, len(self.state.late)
        return JointState(
            vector[:twists].reshape(-1, 6),
            vector[twists : twists + cameras],
            vector[twists + cameras :],
            self.state.points,
        )


def _derivatives(scene: JointScene, knots: Knots, state: JointState) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Differentiate each sighting's pixel by 14 unknowns of the cameras, tell which these are, and by its point."""
    seen = predict(scene, knots, state)
    camera = scene.camera[scene.pose_of]
    focal = scene.focal[camera] * np.exp(state.log_focal[camera])[:, None]
    x, y, z = seen.inside.T
    z = np.where(np.abs(z) < 1e-6, 1e-6, z)
    by_inside = np.zeros((len(z), 2, 3))
    by_inside[:, 0, 0], by_inside[:, 1, 1] = focal[:, 0] / z, focal[:, 1] / z
    by_inside[:, 0, 2], by_inside[:, 1, 2] = -focal[:, 0] * x / z**2, -focal[:, 1] * y / z**2
    by_place = by_inside @ seen.rotation
    by_turn = np.cross(seen.inside[:, None], by_inside)  # a turn w moves a place p by w x p
    by_twist = np.concatenate([by_turn, by_inside], axis=-1)
    share = knots.share[scene.pose_of][:, None, None]
    by_focal = (seen.pixels - scene.centre[camera])[..., None]
    by_late = np.einsum("nij,nj->ni", by_place, seen.velocity)[..., None]
    by_camera = np.concatenate([(1 - share) * by_twist, share * by_twist, by_focal, by_late], axis=-1)
    pairs = 6 * knots.pairs[scene.pose_of]
    base = 6 * knots.count + camera[:, None]
    columns = np.concatenate(
        [pairs[:, :1] + np.arange(6), pairs[:, 1:] + np.arange(6), base, base + len(state.late)], axis=1
    )
    return by_camera, columns, by_place
