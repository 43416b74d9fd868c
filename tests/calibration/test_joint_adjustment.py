"""Background and body adjusted together: a calibration that is off in known ways comes back, and so does the time."""

import numpy as np
import pytest
from joint_world import World, make_world
from scipy.spatial.transform import Rotation

from jaxmocap.calibration._joint_adjustment import Adjusted, JointPriors, _derivatives, adjust_together, unadjusted
from jaxmocap.calibration._joint_scene import moved, place_knots, predict
from jaxmocap.geometry import align_cameras, camera_residuals


def errors(world: World, poses: np.ndarray) -> tuple[float, float, float]:
    """Centres, mean and largest, in metres, and rotations in degrees, after one similarity."""
    centres, angles = camera_residuals(align_cameras(poses, world.poses), poses, world.poses)
    return float(centres.mean()), float(centres.max()), float(np.degrees(angles.mean()))


def refined(world: World, found: Adjusted) -> np.ndarray:
    return moved(world.scene.cam_from_world, found.knots.at_poses(found.state.twists))


@pytest.mark.parametrize("late", [0.012, -0.02])
def test_slow_errors_a_wrong_lens_and_a_part_of_a_frame_come_back(late):
    world = make_world(late=late)
    before = errors(world, world.scene.cam_from_world)
    assert before[0] > 0.01
    assert before[2] > 0.25
    found = adjust_together(world.scene)
    after = errors(world, refined(world, found))
    assert after[0] < 0.001
    assert after[1] < 0.002
    assert after[2] < 0.04
    assert found.state.late[0] == 0
    assert found.state.late[1] == pytest.approx(late, abs=0.0015)  # of 33 ms between frames
    assert abs(found.state.late[1] - late) < 3 * found.deviation.late[1] < 0.003
    assert np.abs(np.exp(found.state.log_focal) * 1.01 - 1).max() < 0.004


def test_cameras_that_are_right_stay_and_wrong_sightings_do_not_count():
    world = make_world(late=0.0, turn=0.0, shift=0.0, focal=1.0)
    background = np.flatnonzero(world.scene.point_of >= world.scene.num_body)
    world.scene.pixels[background[::20]] += [25.0, -40.0]
    found = adjust_together(world.scene)
    assert errors(world, refined(world, found))[0] < 0.001
    assert abs(found.state.late[1]) < 0.0015
    assert found.cost[1] < found.cost[0]


def test_without_background_only_the_time_is_found():
    world = make_world(turn=0.0, shift=0.0, focal=1.0)
    scene = world.scene
    body = scene.point_of < scene.num_body
    scene = scene._replace(
        points=scene.points[: scene.num_body],
        pose_of=scene.pose_of[body],
        point_of=scene.point_of[body],
        pixels=scene.pixels[body],
        sigma=scene.sigma[body],
    )
    found = adjust_together(scene, JointPriors(turn=0.0, shift=0.0, focal=0.0))
    assert not found.state.twists.any()
    assert not found.state.log_focal.any()
    assert found.state.late[1] == pytest.approx(world.late, abs=0.0015)


def test_derivatives_are_those_of_the_prediction():
    scene = make_world(count=8).scene
    knots, state = unadjusted(scene, 0.1)
    by_camera, columns, by_point = _derivatives(scene, knots, state)
    twists, step = 6 * knots.count, 1e-6
    vector = np.concatenate([state.twists.ravel(), state.log_focal, state.late])
    rows = np.arange(len(scene.pixels))
    for column in (0, 4, 5, 9, twists, twists + 1, twists + 3):
        shifted = vector.copy()
        shifted[column] += step
        there = state._replace(
            twists=shifted[:twists].reshape(-1, 6), log_focal=shifted[twists : twists + 2], late=shifted[twists + 2 :]
        )
        change = (predict(scene, knots, there).pixels - predict(scene, knots, state).pixels) / step
        named = np.where((columns == column)[:, None], by_camera, 0).sum(axis=2)
        np.testing.assert_allclose(named[rows], change, rtol=1e-3, atol=1e-2)
    moved_points = state._replace(points=state.points + [0, step, 0])
    change = (predict(scene, knots, moved_points).pixels - predict(scene, knots, state).pixels) / step
    np.testing.assert_allclose(by_point[..., 1], change, rtol=1e-3, atol=1e-2)


def test_knots_lie_on_every_path_and_lines_between_them():
    camera, seconds = np.repeat([0, 1], [31, 1]), np.concatenate([np.arange(31) / 30, [5.0]])
    knots = place_knots(camera, seconds, 0.25)
    assert knots.count == 5 + 2
    twists = np.arange(7.0)[:, None] * np.ones(6)
    np.testing.assert_allclose(knots.at_poses(twists)[:31, 0], 4 * seconds[:31], atol=1e-9)
    pose = np.eye(4)[None]
    turned = moved(pose, np.array([[0, 0.1, 0, 1.0, 2.0, 3.0]]))
    np.testing.assert_allclose(turned[0, :3, :3], Rotation.from_rotvec([0, 0.1, 0]).as_matrix())
    np.testing.assert_allclose(turned[0, :3, 3], [1, 2, 3])
