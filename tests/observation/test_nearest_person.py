"""Which of several people is ours."""

import numpy as np
import pytest

from jaxmocap.observation import expected_keypoints, nearest_person

FRAME = 1


@pytest.fixture(scope="module")
def expected(world):
    return expected_keypoints(world.character, world.pose(FRAME), world.cameras.at(FRAME))


def test_points_are_expected_where_landmarks_are_seen(world, expected):
    keypoints = world.keypoints(FRAME)
    found = keypoints[0, :, 2] > 0
    np.testing.assert_array_equal(np.isfinite(expected[..., 0]), np.stack([found, found]))
    np.testing.assert_allclose(expected[:, found], keypoints[:, found, :2], atol=1e-3)


def test_ours_is_the_person_nearest_to_where_we_are_expected(world, expected):
    ours = world.keypoints(FRAME)[0]
    sure, far = ours.copy(), ours.copy()
    ours[:, :2] += 5.0
    ours[:, 2] *= 0.5
    ours[3, :2] += 500.0  # one point of ours is grossly wrong
    sure[:, 0] += 40.0
    far[:, 0] += 400.0
    assert nearest_person([far, sure, ours], expected[0]) is ours
    assert nearest_person([far], expected[0]) is None
    assert nearest_person([], expected[0]) is None
    nobody = ours * [1, 1, 0]
    assert nearest_person([nobody], expected[0]) is None
