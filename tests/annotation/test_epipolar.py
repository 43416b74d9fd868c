"""Epipolar lines against answers known from projection."""

import cv2
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmocap.annotation import EpipolarGeometry, epipolar_segment
from jaxmocap.camera import Cameras

K = np.array([[800.0, 0, 320], [0, 800.0, 240], [0, 0, 1]])
BOX = (0.0, 0.0, 640.0, 480.0)


def shifted(x: float, z: float = 0.0) -> np.ndarray:
    """A camera that looks along z from (x, 0, z)."""
    pose = np.eye(4)
    pose[:3, 3] = -x, 0, -z
    return pose


def pair(poses: np.ndarray, lens: np.ndarray) -> EpipolarGeometry:
    """Two static cameras of the same make."""
    matrices, lenses = jnp.asarray(np.stack([K, K])), jnp.asarray(np.stack([lens, lens]))
    return EpipolarGeometry(Cameras(("a", "b"), ((640, 480),) * 2, matrices, lenses, jnp.asarray(poses[:, None])))


def test_of_a_rectified_pair_it_is_the_same_row_from_the_edge_to_the_pixel():
    found = epipolar_segment(np.stack([K, K]), np.stack([shifted(0), shifted(0.5)]), np.array([400.0, 123.0]), BOX)
    np.testing.assert_allclose(found, [[0, 123], [400, 123]], atol=1e-6)


def test_of_a_camera_further_ahead_it_leads_from_the_epipole_and_nothing_behind_counts():
    poses = np.stack([shifted(0), shifted(0, 1.0)])
    found = epipolar_segment(np.stack([K, K]), poses, np.array([340.0, 240.0]), BOX)
    np.testing.assert_allclose(found[1], [340, 240], atol=1e-6)  # far away both see it at the same pixel
    assert found[0][0] == pytest.approx(640)  # just before the second camera it is at the edge
    turned = poses[1].copy()
    turned[:3, :3] = np.diag([-1.0, 1.0, -1.0])
    turned[:3, 3] = 0, 0, 5  # at z = 5, looking back: sees the ray's nearer part alone
    found = epipolar_segment(np.stack([K, K]), np.stack([poses[0], turned]), np.array([340.0, 240.0]), BOX)
    np.testing.assert_allclose(found, [[320, 240], [0, 240]], atol=1e-6)  # from the first camera to out of its picture
    away = turned.copy()
    away[:3, 3] = 0, 0, -1  # at z = -1, looking away from all of it
    assert epipolar_segment(np.stack([K, K]), np.stack([poses[0], away]), np.array([340.0, 240.0]), BOX) is None


@pytest.mark.parametrize("lens", [np.zeros(5), np.array([-0.25, 0.08, 0.002, -0.001, 0.0])], ids=["pinhole", "lens"])
def test_what_two_cameras_see_lies_on_the_line(lens):
    generator = np.random.default_rng(3)
    poses = np.stack([np.eye(4), np.eye(4)])
    poses[0][:3, 3] = 0.1, 0, 4
    poses[1][:3, :3] = cv2.Rodrigues(np.array([0.1, 0.7, -0.05]))[0]
    poses[1][:3, 3] = 0.2, -0.1, 4
    geometry = pair(poses, lens)
    centred = K - np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
    for point in generator.uniform(-0.7, 0.7, (20, 3)):
        seen = [
            cv2.projectPoints(point, cv2.Rodrigues(pose[:3, :3])[0], pose[:3, 3], centred, lens)[0].ravel() + 0.5
            for pose in poses
        ]
        line = geometry.line(0, 0, 1, seen[0])
        start, way = line[:-1], np.diff(line, axis=0)
        share = np.clip(((seen[1] - start) * way).sum(1) / (way**2).sum(1), 0, 1)
        distance = np.linalg.norm(seen[1] - start - share[:, None] * way, axis=1)
        assert distance.min() < 0.2  # a lens bends the line between its vertices


def test_a_lens_bends_the_line_and_a_pinhole_does_not():
    lens = np.array([-0.25, 0.08, 0.0, 0.0, 0.0])
    poses = np.stack([shifted(0), shifted(0.5)])
    straight, bent = (pair(poses, d).line(0, 0, 1, np.array([600.0, 40.0])) for d in (np.zeros(5), lens))
    assert len(straight) == 2
    assert np.ptp(bent[:, 1]) > 2
