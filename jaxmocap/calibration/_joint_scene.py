"""What a bundle adjustment of background and body together sees, and what it predicts."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.interpolate import CubicSpline

from ._path_knots import Knots, moved


class Body(NamedTuple):
    """Points of the body on their tracked paths. `path` gives all places (track, 3) at a time of the common clock
    between `start` and `stop`; body point i lies on track `track[i]`, and stood there at `seconds[i]`."""

    path: CubicSpline
    start: float
    stop: float
    track: Int[np.ndarray, " body"]
    seconds: Float[np.ndarray, " body"]

    def moved_by(self, point: np.ndarray, seconds: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """How far body points have moved since their own times at other `seconds`, and their velocities then."""
        now, rows, track = np.clip(seconds, self.start, self.stop), np.arange(len(point)), self.track[point]
        velocity = self.path(now, 1)[rows, track]
        shift = self.path(now)[rows, track] - self.path(self.seconds[point])[rows, track]
        return shift + velocity * (seconds - now)[:, None], velocity  # straight on past the ends


class JointScene(NamedTuple):
    """Poses with their cameras and times (on the common clock, as far as `offset` is known), lenses, points, and what
    was seen of them. The first `len(body.track)` points are the body's, the others stand still. Pixels have the lenses'
    distortion taken out; `sigma` is their standard deviation."""

    cam_from_world: Float[np.ndarray, "pose 4 4"]
    camera: Int[np.ndarray, " pose"]
    seconds: Float[np.ndarray, " pose"]
    focal: Float[np.ndarray, "camera 2"]
    centre: Float[np.ndarray, "camera 2"]
    points: Float[np.ndarray, "point 3"]
    body: Body
    pose_of: Int[np.ndarray, " sighting"]
    point_of: Int[np.ndarray, " sighting"]
    pixels: Float[np.ndarray, "sighting 2"]
    sigma: Float[np.ndarray, " sighting"]

    @property
    def num_body(self) -> int:
        return len(self.body.track)


class JointState(NamedTuple):
    """The unknowns: twists at the knots, logarithms of the focal lengths' factors, later starts of the cameras' clocks
    in seconds (added to `seconds`), and the points."""

    twists: Float[np.ndarray, "knot 6"]
    log_focal: Float[np.ndarray, " camera"]
    late: Float[np.ndarray, " camera"]
    points: Float[np.ndarray, "point 3"]


class Prediction(NamedTuple):
    """Pixels, and by what they change: places in the camera, its rotations, and velocities, zero but for the body."""

    pixels: Float[np.ndarray, "sighting 2"]
    inside: Float[np.ndarray, "sighting 3"]
    rotation: Float[np.ndarray, "sighting 3 3"]
    velocity: Float[np.ndarray, "sighting 3"]


def predict(scene: JointScene, knots: Knots, state: JointState) -> Prediction:
    poses = moved(scene.cam_from_world, knots.at_poses(state.twists))[scene.pose_of]
    camera = scene.camera[scene.pose_of]
    places = state.points[scene.point_of].copy()
    velocity = np.zeros_like(places)
    body = np.flatnonzero(scene.point_of < scene.num_body)
    if len(body):
        seconds = scene.seconds[scene.pose_of[body]] + state.late[camera[body]]
        shift, velocity[body] = scene.body.moved_by(scene.point_of[body], seconds)
        places[body] += shift
    inside = np.einsum("nij,nj->ni", poses[:, :3, :3], places) + poses[:, :3, 3]
    depth = np.where(np.abs(inside[:, 2:]) < 1e-6, 1e-6, inside[:, 2:])
    focal = scene.focal[camera] * np.exp(state.log_focal[camera])[:, None]
    return Prediction(focal * inside[:, :2] / depth + scene.centre[camera], inside, poses[:, :3, :3], velocity)
