"""Directions of cameras: the angles between them, and which way is up."""

import numpy as np
from scipy.spatial.transform import Rotation
from small_captures import look_at_pose

from jaxmocap.camera import view_angles, world_from_upright


def test_angles_between_views_are_seen_from_the_body():
    """Cameras at 0, 30 and 90 degrees around a point, at different distances."""
    poses = []
    for degrees, distance in ((0, 2.0), (30, 3.0), (90, 5.0)):
        pose, angle = np.eye(4), np.radians(degrees)
        pose[:3, 3] = -(np.array([1.0, 2.0, 3.0]) + distance * np.array([np.sin(angle), 0, np.cos(angle)]))
        poses.append(pose)
    found = view_angles(np.stack(poses), np.array([1.0, 2.0, 3.0]))
    np.testing.assert_allclose(found, [[0, 30, 90], [30, 0, 60], [90, 60, 0]], atol=1e-4)


def test_y_is_where_the_upper_edges_of_pictures_point_to():
    """Cameras around a person who stands along y, in a world that was turned."""
    turn = Rotation.from_rotvec([0.4, 0.2, -0.7]).as_matrix()
    poses = np.stack([look_at_pose(angle) for angle in (0.0, 70.0, 200.0)])
    poses[:, :3, :3] = poses[:, :3, :3] @ turn.T
    found = world_from_upright(poses)
    np.testing.assert_allclose(found[:, 1], turn[:, 1], atol=1e-12)
    np.testing.assert_allclose(found.T @ found, np.eye(3), atol=1e-12)
    assert np.linalg.det(found) > 0
