"""What a bundle adjustment of background and body together sees, and what it predicts."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation


class Knots(NamedTuple):
    """Knots in time of slow corrections of the cameras' paths: small twists, with straight lines between them.

    Attributes:
        count: of the knots of all cameras.
        pairs: the two knots that each pose lies between.
        share: of the second of them, from 0 to 1.
        neighbours: pairs of knots of one camera that follow each other.
    """

    count: int
    pairs: Int[np.ndarray, "pose 2"]
    share: Float[np.ndarray, " pose"]
    neighbours: Int[np.ndarray, "pair 2"]

    def at_poses(self, twists: Float[np.ndarray, "knot 6"]) -> Float[np.ndarray, "pose 6"]:
        """Interpolate twists at the knots to the poses."""
        first, second = twists[self.pairs[:, 0]], twists[self.pairs[:, 1]]
        return (1 - self.share[:, None]) * first + self.share[:, None] * second


def place_knots(camera: Int[np.ndarray, " pose"], seconds: Float[np.ndarray, " pose"], apart: float) -> Knots:
    """Place knots at most `apart` seconds from each other over each camera's poses, at least two for each."""
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
    """Apply a turn (rotation vector) and then a shift to poses, both in the camera's axes."""
    turn = Rotation.from_rotvec(twist[:, :3]).as_matrix()
    result = np.array(cam_from_world, np.float64)
    result[:, :3] = turn @ cam_from_world[:, :3]
    result[:, :3, 3] += twist[:, 3:]
    return result


class Body(NamedTuple):
    """Points of the body on their tracked paths.

    Attributes:
        path: gives all places (track, 3), metres, at a time of the common clock.
        start: of the paths, seconds.
        stop: of the paths, seconds.
        track: the path that each point lies on.
        seconds: when it stood there.
    """

    path: CubicSpline
    start: float
    stop: float
    track: Int[np.ndarray, " body"]
    seconds: Float[np.ndarray, " body"]

    def moved_by(self, point: np.ndarray, seconds: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Tell how far body points have moved from their own times to `seconds` (metres), and their velocities then."""
        now, rows, track = np.clip(seconds, self.start, self.stop), np.arange(len(point)), self.track[point]
        velocity = self.path(now, 1)[rows, track]
        shift = self.path(now)[rows, track] - self.path(self.seconds[point])[rows, track]
        return shift + velocity * (seconds - now)[:, None], velocity  # straight on past the ends


class JointScene(NamedTuple):
    """Poses, lenses, points of the background and of the body, and what was seen of them.

    Attributes:
        cam_from_world: poses, metres.
        camera: that each pose is of.
        seconds: of each pose on the common clock, as far as `offset` in `capture.toml` is known.
        focal: lengths along x and y, pixels.
        centre: principal points, pixels.
        points: metres; the first `num_body` are the body's, the others stand still.
        body: how the body's points move.
        pose_of: the pose that makes each sighting.
        point_of: the point it is of.
        pixels: the lenses' distortion taken out.
        sigma: standard deviation of `pixels`.
    """

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
    """The unknowns.

    Attributes:
        twists: at the knots, radians and metres.
        log_focal: logarithms of the focal lengths' factors.
        late: later starts of the cameras' clocks, seconds; added to the scene's `seconds`.
        points: metres.
    """

    twists: Float[np.ndarray, "knot 6"]
    log_focal: Float[np.ndarray, " camera"]
    late: Float[np.ndarray, " camera"]
    points: Float[np.ndarray, "point 3"]


class Prediction(NamedTuple):
    """What each sighting should show, and what its derivatives are made of.

    Attributes:
        pixels: where the point should be seen.
        inside: its place in the camera's axes, metres.
        rotation: of the camera.
        velocity: of the point, metres a second; zero but for the body.
    """

    pixels: Float[np.ndarray, "sighting 2"]
    inside: Float[np.ndarray, "sighting 3"]
    rotation: Float[np.ndarray, "sighting 3 3"]
    velocity: Float[np.ndarray, "sighting 3"]


def predict(scene: JointScene, knots: Knots, state: JointState) -> Prediction:
    """Project every sighted point at the time of its sighting."""
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
