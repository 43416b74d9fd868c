import numpy as np
import pytest
from moving_cameras import centres_of, paths
from scipy.spatial.transform import Rotation

from jaxmocap.calibration._trajectory import find_outliers, interpolate

TIMES = np.arange(40.0)


def spoilt(pose: np.ndarray, shift: float, turn: float, axis: int = 0) -> np.ndarray:
    """The camera `shift` metres aside and turned by `turn` degrees about its own axis."""
    result = pose.copy()
    centre = centres_of(pose) + shift * np.eye(3)[axis]
    result[:3, :3] = Rotation.from_rotvec(np.radians(turn) * np.eye(3)[axis]).as_matrix() @ pose[:3, :3]
    result[:3, 3] = -result[:3, :3] @ centre
    return result


def test_a_shaken_hand_is_no_outlier():
    for seed in range(3):
        for path in paths(seed=seed):
            assert not find_outliers(TIMES, path, 4.0).outlier.any()


@pytest.mark.parametrize(("shift", "turn"), [(3.0, 48.0), (0.25, 0.0), (0.0, 5.0), (0.1, 1.5)])
def test_single_wrong_poses_are_found_and_nothing_else(shift, turn):
    wrong = [0, 11, 12, 30, 39]
    for path in paths():
        for number, index in enumerate(wrong):
            path[index] = spoilt(path[index], shift, turn, number % 3)
        assert np.flatnonzero(find_outliers(TIMES, path, 4.0).outlier).tolist() == wrong


def test_a_run_of_wrong_poses_does_not_bend_the_path():
    path = paths()[0]
    for index in range(20, 25):
        path[index] = spoilt(path[index], 0.5, 10.0)
    assert np.flatnonzero(find_outliers(TIMES, path, 4.0).outlier).tolist() == [20, 21, 22, 23, 24]


def test_a_still_camera_has_no_outliers_and_one_jump_of_it_has():
    path = np.repeat(paths()[0][:1], 40, axis=0)
    assert not find_outliers(TIMES, path, 4.0).outlier.any()
    path[7] = spoilt(path[7], 0.1, 0.0)
    assert np.flatnonzero(find_outliers(TIMES, path, 4.0).outlier).tolist() == [7]


def test_missing_poses_lie_between_their_neighbours():
    path = paths()[0]
    known = np.ones(40, bool)
    known[[0, 20, 21, 39]] = False
    damaged = np.where(known[:, None, None], path, np.eye(4))
    filled = interpolate(TIMES, damaged, known)
    np.testing.assert_array_equal(filled[known], path[known])
    assert np.linalg.norm(centres_of(filled) - centres_of(path), axis=-1).max() < 0.03
    turn = Rotation.from_matrix(filled[:, :3, :3] @ path[:, :3, :3].transpose(0, 2, 1)).magnitude()
    assert np.degrees(turn.max()) < 1.5
    expected = centres_of(path[19]) + (centres_of(path[22]) - centres_of(path[19])) / 3
    np.testing.assert_allclose(centres_of(filled[20]), expected, atol=1e-12)
    with pytest.raises(ValueError, match="no pose"):
        interpolate(TIMES, path, np.zeros(40, bool))
