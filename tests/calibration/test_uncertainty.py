import numpy as np
import pytest
from moving_cameras import FOCAL, centres_of, paths
from scipy.spatial.transform import Rotation

from jaxmocap.calibration._uncertainty import Network, deviation_given_points, pose_deviation
from jaxmocap.geometry import align_cameras, camera_residuals

RADIAL = 0.03


def small_network(sigma: float = 0.5) -> Network:
    generator = np.random.default_rng(0)
    poses = paths(5).reshape(-1, 4, 4)
    points = generator.uniform([-3, -0.5, -3], [3, 2.5, 1], (70, 3))
    pose_of, point_of = np.divmod(np.arange(len(poses) * len(points)), len(points))
    kept = generator.random(len(pose_of)) < 0.8
    return Network(
        poses, np.repeat([0, 1], 5), np.full(2, FOCAL), np.full(2, RADIAL), points, pose_of[kept], point_of[kept], sigma
    )


def observed(network: Network, step: np.ndarray) -> np.ndarray:
    """Pixels after a step in the poses (turn about the centre in world axes, shift), lenses and points."""
    poses, lenses = len(network.cam_from_world), len(network.focal)
    by_pose, rest = step[: 6 * poses].reshape(poses, 6), step[6 * poses :]
    by_lens, by_point = rest[: 2 * lenses].reshape(lenses, 2), rest[2 * lenses :].reshape(-1, 3)
    rotation = network.cam_from_world[:, :3, :3] @ Rotation.from_rotvec(by_pose[:, :3]).as_matrix().transpose(0, 2, 1)
    centres = centres_of(network.cam_from_world) + by_pose[:, 3:]
    points = network.points + by_point
    inside = np.einsum("nij,nj->ni", rotation[network.pose_of], points[network.point_of] - centres[network.pose_of])
    place = inside[:, :2] / inside[:, 2:]
    lens = network.lens[network.pose_of]
    stretch = 1 + (network.radial + by_lens[:, 1])[lens] * (place**2).sum(1)
    return ((network.focal * np.exp(by_lens[:, 0]))[lens] * stretch)[:, None] * place


@pytest.fixture(scope="module")
def jacobian() -> np.ndarray:
    network = small_network()
    size = 6 * 10 + 4 + 3 * 70
    columns = []
    for index in range(size):
        step = np.zeros(size)
        step[index] = 1e-6
        columns.append((observed(network, step) - observed(network, -step)).ravel() / 2e-6)
    return np.stack(columns, 1)


def test_deviations_are_those_of_many_noisy_adjustments(jacobian):
    network = small_network()
    predicted = pose_deviation(network)
    generator = np.random.default_rng(1)
    solve = np.linalg.pinv(jacobian, rcond=1e-9)
    distances, angles = [], []
    for _ in range(150):
        step = solve @ (network.sigma * generator.normal(size=len(jacobian)))
        by_pose = step[:60].reshape(10, 6)
        poses = network.cam_from_world.copy()
        poses[:, :3, :3] = poses[:, :3, :3] @ Rotation.from_rotvec(by_pose[:, :3]).as_matrix().transpose(0, 2, 1)
        poses[:, :3, 3] = -np.einsum(
            "nij,nj->ni", poses[:, :3, :3], centres_of(network.cam_from_world) + by_pose[:, 3:]
        )
        distance, angle = camera_residuals(align_cameras(poses, network.cam_from_world), poses, network.cam_from_world)
        distances.append(distance)
        angles.append(angle)
    measured = np.sqrt(np.mean(np.square(distances), 0)), np.sqrt(np.mean(np.square(angles), 0))
    np.testing.assert_allclose(predicted.centre, measured[0], rtol=0.35)
    np.testing.assert_allclose(predicted.angle, measured[1], rtol=0.35)
    assert predicted.centre.mean() == pytest.approx(measured[0].mean(), rel=0.15)


def test_deviations_grow_with_the_noise_and_are_larger_than_with_exact_points(jacobian):
    one, two = pose_deviation(small_network(0.5)), pose_deviation(small_network(1.0))
    np.testing.assert_allclose(two.centre, 2 * one.centre, rtol=1e-6)
    own = deviation_given_points(small_network(0.5))
    normal = jacobian[:, :6].T @ jacobian[:, :6]
    variance = 0.25 * np.diag(np.linalg.inv(normal))
    assert own.angle[0] == pytest.approx(np.sqrt(variance[:3].sum()), rel=1e-4)
    assert own.centre[0] == pytest.approx(np.sqrt(variance[3:].sum()), rel=1e-4)
