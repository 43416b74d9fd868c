import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxmocap.geometry import align_cameras, camera_residuals, fit_similarity

RNG = np.random.default_rng(3)
ROTATION = Rotation.from_rotvec([0.4, -1.2, 2.0]).as_matrix()
TRANSLATION = np.array([3.0, -2.0, 5.0])


def _cameras(centres):
    """Cameras at `centres` that look about, as cam_from_world."""
    poses = np.tile(np.eye(4), (len(centres), 1, 1))
    poses[:, :3, :3] = Rotation.random(len(centres), rng=RNG).as_matrix()
    poses[:, :3, 3] = -np.einsum("nij,nj->ni", poses[:, :3, :3], centres)
    return poses


def _moved(poses, scale):
    """The same cameras in the world target = scale ROTATION source + TRANSLATION."""
    centres = -np.einsum("nji,nj->ni", poses[:, :3, :3], poses[:, :3, 3])
    moved = poses.copy()
    moved[:, :3, :3] = poses[:, :3, :3] @ ROTATION.T
    moved[:, :3, 3] = -np.einsum("nij,nj->ni", moved[:, :3, :3], scale * centres @ ROTATION.T + TRANSLATION)
    return moved


def test_similarity_of_points_is_recovered():
    points = RNG.standard_normal((9, 3))
    found = fit_similarity(points, 2.5 * points @ ROTATION.T + TRANSLATION)
    assert np.isclose(found.scale, 2.5)
    assert np.allclose(found.rotation, ROTATION)
    assert np.allclose(found.translation, TRANSLATION)
    assert np.isclose(found.angle, np.linalg.norm(Rotation.from_matrix(ROTATION).as_rotvec()))


@pytest.mark.parametrize("flat", [1.0, 0.0])
def test_mirrored_points_are_never_matched_by_a_reflection(flat):
    points = RNG.standard_normal((12, 3)) * [1, 1, flat]
    found = fit_similarity(points, points * [-1, 1, 1])
    assert np.isclose(np.linalg.det(found.rotation), 1)


def test_without_scale_the_motion_is_rigid():
    points = RNG.standard_normal((9, 3))
    found = fit_similarity(points, 2.5 * points @ ROTATION.T + TRANSLATION, with_scale=False)
    assert found.scale == 1
    assert np.allclose(found.rotation, ROTATION)


@pytest.mark.parametrize("count", [2, 3, 40])
def test_similarity_of_cameras_is_recovered_even_from_two(count):
    poses = _cameras(4 * RNG.standard_normal((count, 3)))
    found = align_cameras(poses, _moved(poses, 0.3))
    assert np.isclose(found.scale, 0.3)
    assert np.allclose(found.rotation, ROTATION)
    assert np.allclose(found.translation, TRANSLATION)
    distance, angle = camera_residuals(found, poses, _moved(poses, 0.3))
    assert distance.max() < 1e-9
    assert angle.max() < 1e-6


def test_one_camera_fixes_all_but_the_scale():
    poses = np.repeat(_cameras(np.ones((1, 3))), 5, axis=0)
    found = align_cameras(poses, _moved(poses, 2.0))
    assert found.scale == 1
    assert np.allclose(found.rotation, ROTATION)


def test_camera_residuals_measure_what_is_left():
    poses = _cameras(RNG.standard_normal((4, 3)))
    turned = poses.copy()
    turned[:, :3, :3] = Rotation.from_rotvec([0, 0, 0.1]).as_matrix() @ poses[:, :3, :3]
    turned[:, :3, 3] = -np.einsum("nij,nj->ni", turned[:, :3, :3], _centres(poses) + [0, 0.2, 0])
    identity = fit_similarity(np.eye(3), np.eye(3))
    distance, angle = camera_residuals(identity, poses, turned)
    assert np.allclose(distance, 0.2)
    assert np.allclose(angle, 0.1)


def _centres(poses):
    return -np.einsum("nji,nj->ni", poses[:, :3, :3], poses[:, :3, 3])
