"""How certain the poses are: covariance of a bundle adjustment without fixed frame (free network).

The normal equations are reduced to poses and intrinsics (Schur complement) and inverted on the complement of the seven
directions that move the whole world (Triggs et al. 2000, sec. 9), so that the answer is about the shape of the network
and not about an arbitrary origin.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxmocap.geometry import camera_centres

from ._mapping import median_depth, observations
from ._matching import Place
from ._registration import Model
from ._repair import departures
from ._trajectory import MAD_TO_SIGMA

_PER_POSE, _PER_LENS, _GAUGE = 6, 2, 7
_MOST_IN_NETWORK = 120


class Network(NamedTuple):
    """What a bundle adjustment sees.

    Attributes:
        cam_from_world: poses, in the world's units.
        lens: the camera of each pose.
        focal: length of each lens, pixels.
        radial: distortion k1 of each lens.
        points: in the world.
        pose_of: the pose that makes each observation.
        point_of: the point it is of.
        sigma: standard deviation of a pixel coordinate.
    """

    cam_from_world: Float[np.ndarray, "pose 4 4"]
    lens: Int[np.ndarray, " pose"]
    focal: Float[np.ndarray, " lens"]
    radial: Float[np.ndarray, " lens"]
    points: Float[np.ndarray, "point 3"]
    pose_of: Int[np.ndarray, " observation"]
    point_of: Int[np.ndarray, " observation"]
    sigma: float


class PoseDeviation(NamedTuple):
    """Standard deviations of poses, each the root of the summed variances of three axes.

    Attributes:
        centre: in the world's units.
        angle: of the orientation, radians.
    """

    centre: Float[np.ndarray, " pose"]
    angle: Float[np.ndarray, " pose"]


def _jacobians(network: Network) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Differentiate each observation by its pose (turn of the camera about its centre in world axes, then its centre),
    by focal length (logarithm) and k1, and by its point."""
    rotation = network.cam_from_world[network.pose_of, :3, :3]
    inside = np.einsum("nij,nj->ni", rotation, network.points[network.point_of])
    inside += network.cam_from_world[network.pose_of, :3, 3]
    lens = network.lens[network.pose_of]
    focal, radial = network.focal[lens], network.radial[lens]
    x, y, z = inside.T
    u, v = x / z, y / z
    square = u**2 + v**2
    stretch = 1 + radial * square
    by_plane = np.empty((len(u), 2, 2))  # derivative of the distorted by the ideal place, times the focal length
    by_plane[:, 0, 0] = focal * (stretch + 2 * radial * u * u)
    by_plane[:, 0, 1] = by_plane[:, 1, 0] = focal * 2 * radial * u * v
    by_plane[:, 1, 1] = focal * (stretch + 2 * radial * v * v)
    plane_by_inside = np.zeros((len(u), 2, 3))
    plane_by_inside[:, 0, 0] = plane_by_inside[:, 1, 1] = 1 / z
    plane_by_inside[:, 0, 2], plane_by_inside[:, 1, 2] = -u / z, -v / z
    by_point = by_plane @ plane_by_inside @ rotation  # inside = R (X - c)
    arm = np.einsum("nji,nj->ni", rotation, inside)  # X - c; a turn w of the camera moves it by -w x (X - c)
    by_turn = np.cross(by_point, arm[:, None, :], axis=-1)
    by_pose = np.concatenate([by_turn, -by_point], axis=-1)
    place = np.stack([u, v], -1)
    by_lens = np.stack([(focal * stretch)[:, None] * place, (focal * square)[:, None] * place], axis=-1)
    return by_pose, by_lens, by_point


def pose_deviation(network: Network) -> PoseDeviation:
    """Compute the standard deviations of all poses after the best similarity; points seen only once do not count."""
    poses, lenses = len(network.cam_from_world), len(network.focal)
    size = _PER_POSE * poses + _PER_LENS * lenses
    by_pose, by_lens, by_point = _jacobians(network)
    columns = np.concatenate(
        [
            _PER_POSE * network.pose_of[:, None] + np.arange(_PER_POSE),
            _PER_POSE * poses + _PER_LENS * network.lens[network.pose_of][:, None] + np.arange(_PER_LENS),
        ],
        axis=1,
    )
    rows = np.concatenate([by_pose, by_lens], axis=-1)
    normal = np.zeros((size, size))
    order = np.argsort(network.point_of, kind="stable")
    starts = np.flatnonzero(np.diff(network.point_of[order], prepend=-1))
    for index in np.split(order, starts[1:]):
        if len(index) < 2:
            continue
        a, b = rows[index], by_point[index].reshape(-1, 3)
        wide = np.zeros((2 * len(index), size_local := a.shape[-1] * len(index)))
        for number, block in enumerate(a):
            wide[2 * number : 2 * number + 2, number * a.shape[-1] : (number + 1) * a.shape[-1]] = block
        half = wide.T @ b
        reduced = wide.T @ wide - half @ np.linalg.pinv(b.T @ b) @ half.T
        where = columns[index].reshape(size_local)
        np.add.at(normal, (where[:, None], where[None, :]), reduced)
    scale = np.ones(size)  # centres in units of their spread, so that the gauge is that of the best similarity
    centres = camera_centres(network.cam_from_world)
    spread = float(np.sqrt(np.mean(np.sum((centres - centres.mean(0)) ** 2, axis=1))))
    length = max(spread, 1e-3 * float(np.linalg.norm(network.points.mean(0) - centres.mean(0))))
    scale.reshape(-1)[: _PER_POSE * poses].reshape(poses, 6)[:, 3:] = length
    values, vectors = np.linalg.eigh(normal * scale[:, None] * scale[None, :])
    kept = slice(_GAUGE, None)
    half = vectors[:, kept] / np.sqrt(np.maximum(values[kept], 1e-12 * values[-1]))
    variance = network.sigma**2 * np.sum((scale[:, None] * half) ** 2, axis=1)[: _PER_POSE * poses].reshape(poses, 6)
    return PoseDeviation(np.sqrt(variance[:, 3:].sum(1)), np.sqrt(variance[:, :3].sum(1)))


def deviation_given_points(network: Network) -> PoseDeviation:
    """Compute the standard deviations of every pose as if points and lenses were exact: one frame's own noise."""
    by_pose, _, _ = _jacobians(network)
    normal = np.zeros((len(network.cam_from_world), 6, 6))
    np.add.at(normal, network.pose_of, np.einsum("nki,nkj->nij", by_pose, by_pose))
    count = np.bincount(network.pose_of, minlength=len(normal))
    variance = np.full((len(normal), 6), np.inf)
    enough = count >= 4
    variance[enough] = network.sigma**2 * np.diagonal(np.linalg.inv(normal[enough]), axis1=1, axis2=2)
    return PoseDeviation(np.sqrt(variance[:, 3:].sum(1)), np.sqrt(variance[:, :3].sum(1)))


def network_of(model: Model, places: list[Place]) -> Network:
    """Gather the bundle adjustment of these frames, with the residuals' robust standard deviation."""
    reconstruction = model.reconstruction
    lenses = sorted(reconstruction.cameras)
    seen = [observations(reconstruction, model.images[place]) for place in places]
    ids = np.concatenate([points for _, points, _ in seen])
    unique, point_of = np.unique(ids, return_inverse=True)
    residuals = np.concatenate([residual for _, _, residual in seen])
    poses = [model.pose(place) for place in places]
    return Network(
        cam_from_world=np.stack([pose for pose in poses if pose is not None]),
        lens=np.array([camera for camera, _ in places]),
        focal=np.array([reconstruction.cameras[i].params[0] for i in lenses]),
        radial=np.array([reconstruction.cameras[i].params[3] for i in lenses]),
        points=np.array([reconstruction.points3D[int(i)].xyz for i in unique]),
        pose_of=np.repeat(np.arange(len(places)), [len(points) for _, points, _ in seen]),
        point_of=point_of,
        sigma=MAD_TO_SIGMA * float(np.median(np.abs(residuals))),
    )


def deviation_of_places(model: Model, places: list[Place], interpolated: list[Place]) -> PoseDeviation:
    """Compute the standard deviations of the poses of all `places`.

    Key frames have those of their network, the others their own noise besides, interpolated ones the path's shake.
    A camera sees one point in many frames with errors that are alike, since they are the texture's and the
    compression's, so in the network all of a camera's sightings of a point count as one: deviations grow by the root
    of their number.
    """
    usable = [place for place in places if place not in interpolated]
    keys = [place for place in usable if place in model.features]
    keys = keys[:: -(-len(keys) // _MOST_IN_NETWORK)]
    seen = network_of(model, keys)
    alike = len(seen.pose_of) / len(np.unique(np.stack([seen.lens[seen.pose_of], seen.point_of]), axis=1).T)
    network = pose_deviation(seen._replace(sigma=seen.sigma * np.sqrt(alike)))
    paths = [departures(model, camera) for camera in range(len(model.footage.videos))] if interpolated else []
    own = deviation_given_points(network_of(model, usable))
    distance = median_depth(model.reconstruction)
    centre, angle = np.empty(len(places)), np.empty(len(places))
    for index, (camera, frame) in enumerate(places):
        nearest = min(range(len(keys)), key=lambda k: (keys[k][0] != camera, abs(keys[k][1] - frame)))
        shared = network.centre[nearest], network.angle[nearest]
        if (camera, frame) in interpolated:
            path = paths[camera]
            gap = min((abs(f - frame) for c, f in usable if c == camera), default=1)
            single = path.usual_shift * distance * gap, path.usual_turn * gap
        elif (camera, frame) in keys:
            single = 0.0, 0.0
        else:
            at = usable.index((camera, frame))
            single = own.centre[at], own.angle[at]
        centre[index], angle[index] = np.hypot(shared[0], single[0]), np.hypot(shared[1], single[1])
    return PoseDeviation(centre, angle)
