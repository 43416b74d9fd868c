"""Autoregression on recurrences whose next value is known."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmocap._results import InputError
from jaxmocap.character import difference, landmark_positions, rest_pose, retract
from jaxmocap.motion import MotionHistory, after, predict_difference
from jaxmocap.rigging import body


def poses(frames):
    """Three joints: at rest, moving steadily, oscillating with a period of twenty frames."""
    t = np.arange(frames)
    return np.stack([np.full(frames, 0.7), 0.1 + 0.02 * t, 0.5 * np.sin(2 * np.pi * t / 20)], axis=1)


@pytest.mark.parametrize("mode", ["ridge", "quadratic", "velocity"])
def test_steady_motion_continues_and_rest_stays_at_rest(mode):
    history = jnp.asarray(np.diff(poses(31), axis=0))
    predicted = predict_difference(history, mode=mode)
    np.testing.assert_allclose(predicted[:2], [0.0, 0.02], atol=1e-6)


def test_quadratic_is_exact_for_constant_acceleration():
    t = np.arange(9.0)
    angle = 0.3 + 0.1 * t - 0.02 * t**2
    predicted = predict_difference(jnp.diff(jnp.asarray(angle[:8]))[:, None], mode="quadratic")
    np.testing.assert_allclose(predicted[0], angle[8] - angle[7], atol=1e-6)


@pytest.mark.parametrize(("mode", "coefficients"), [("velocity", (2, -1, 0)), ("quadratic", (3, -3, 1))])
def test_coefficients_on_poses_are_those_of_the_third_order_forms(mode, coefficients):
    last, second, third = 0.31, -0.12, 0.55
    predicted = predict_difference(jnp.diff(jnp.array([third, second, last]))[:, None], mode=mode)
    expected = np.dot(coefficients, [last, second, third]) - last
    np.testing.assert_allclose(predicted[0], expected, atol=1e-6)


def test_ridge_follows_an_oscillation_that_the_velocity_form_overshoots():
    angles = poses(37)  # the last pose is just past a peak
    history, truth = jnp.asarray(np.diff(angles[:36], axis=0)), angles[36] - angles[35]
    errors = {mode: abs(predict_difference(history, mode=mode)[2] - truth[2]) for mode in ("ridge", "velocity")}
    assert errors["ridge"] < 0.1 * errors["velocity"]


def test_ridge_recovers_a_damped_recurrence():
    b1, b2 = 1.6, -0.8
    values = [1.0, 0.9]
    for _ in range(30):
        values.append(b1 * values[-1] + b2 * values[-2])
    history = jnp.asarray(values)[:, None] * 0.01
    expected = 0.01 * (b1 * values[-1] + b2 * values[-2])
    np.testing.assert_allclose(predict_difference(history, ridge=1e-5)[0], expected, rtol=1e-3)


def test_a_very_strong_ridge_is_the_velocity_form():
    history = jax.random.normal(jax.random.key(0), (29, 4))
    np.testing.assert_allclose(predict_difference(history, ridge=1e8), history[-1], rtol=1e-4)


@pytest.mark.parametrize("mode", ["ridge", "quadratic", "velocity"])
def test_short_histories_fall_back(mode):
    assert jnp.all(predict_difference(jnp.zeros((0, 2)), mode=mode) == 0)
    one = jnp.array([[0.1, 0.2]])
    np.testing.assert_allclose(predict_difference(one, mode=mode), one[0])
    two = jnp.array([[0.1, 0.2], [0.3, 0.1]])
    expected = 2 * two[1] - two[0] if mode == "quadratic" else two[1]
    np.testing.assert_allclose(predict_difference(two, mode=mode), expected, rtol=1e-6)


@pytest.mark.parametrize("mode", ["ridge", "quadratic", "velocity"])
@pytest.mark.parametrize("count", [0, 1, 2, 6, 7, 20])
def test_fixed_window_with_a_count_equals_the_short_history(mode, count):
    history = jax.random.normal(jax.random.key(1), (count, 3))
    window = jnp.concatenate([jnp.full((29 - count, 3), 99.0), history])
    compiled = jax.jit(lambda rows, valid: predict_difference(rows, valid, mode=mode))
    np.testing.assert_allclose(compiled(window, count), predict_difference(history, mode=mode), atol=1e-5)


def test_prediction_of_tiny_differences_is_finite():
    assert jnp.all(jnp.isfinite(predict_difference(jnp.full((20, 2), 1e-15))))


def test_unknown_mode_is_named():
    with pytest.raises(InputError, match="'cubic'"):
        predict_difference(jnp.zeros((3, 1)), mode="cubic")


def test_a_steady_turn_goes_on_where_a_ball_joint_changes_its_set_of_angles():
    """An upper arm that turns by 4 degrees a frame, and is written by its other angles in some frame on its way."""
    skeleton = body().skeleton
    turning = skeleton.dof_names.index("l_shoulder_abd")
    step, begin = np.zeros((2, skeleton.num_dofs), np.float32)
    begin[turning - 1 : turning + 2] = np.radians([177.0, -100.0, 110.0])
    step[turning] = np.radians(4.0)
    pose = retract(skeleton, rest_pose(skeleton), jnp.asarray(begin))
    history, rewritten = after(skeleton, None, 0.0, pose, "away_from_limits"), 0
    for frame in range(1, 45):
        pose = retract(skeleton, pose, jnp.asarray(step))
        history = after(skeleton, history, frame / 30, pose, "away_from_limits")
        rewritten += not np.allclose(history.pose.angles, pose.angles, atol=1e-3)
        for mode in ("velocity", "ridge"):
            predicted = retract(
                skeleton, history.pose, jnp.asarray(history.predicted(mode, (frame + 1) / 30), jnp.float32)
            )
            following = retract(skeleton, pose, jnp.asarray(step))
            places = [np.asarray(landmark_positions(skeleton, one)) for one in (predicted, following)]
            np.testing.assert_allclose(places[0], places[1], atol=1e-3)
    assert 0 < rewritten < 44


SKELETON = body().skeleton
WAY = np.zeros(SKELETON.num_dofs, np.float32)
WAY[[0, SKELETON.dof_names.index("l_elbow_flex"), SKELETON.dof_names.index("r_knee_flex")]] = 0.04, 0.05, 0.03


def at(number: float):
    """The pose after so many intervals of a motion that goes on evenly."""
    return retract(SKELETON, rest_pose(SKELETON), jnp.asarray(number * WAY, jnp.float32))


def followed(numbers, seconds, pose_at=at) -> MotionHistory:
    """The history of frames taken at these numbers of intervals, whose times are told as `seconds`."""
    history = None
    for number, second in zip(numbers, seconds, strict=True):
        history = after(SKELETON, history, second, pose_at(number), "same", 1 / 30)
    return history


@pytest.mark.parametrize("mode", ["ridge", "quadratic", "velocity"])
@pytest.mark.parametrize("ahead", [1, 4, -3])
def test_an_even_motion_goes_on_evenly_whichever_frames_are_missing(mode, ahead):
    """Three missing frames were one step, and half the way of an arm at 1.5 radians a second was lost."""
    way = np.sign(ahead)  # tracking runs backwards, too
    numbers = way * np.array([0, 1, 2, 5, 6, 7, 10, 12, 13, 14])
    history = followed(numbers, numbers / 30)
    assert len(history.increments) == 14
    np.testing.assert_allclose(history.increments, np.tile(way * WAY, (14, 1)), atol=1e-5)
    following = numbers[-1] + ahead
    np.testing.assert_allclose(history.predicted(mode, following / 30), ahead * WAY, atol=1e-4)


def test_a_rate_that_varies_tells_the_speed_as_an_even_one():
    rng = np.random.default_rng(0)
    numbers = np.cumsum(rng.uniform(0.7, 1.4, 25))
    history = followed(numbers, numbers / 30)
    np.testing.assert_allclose(history.increments, np.tile(WAY, (24, 1)), rtol=0.06, atol=1e-6)
    np.testing.assert_allclose(history.predicted("ridge", (numbers[-1] + 1.37) / 30), 1.37 * WAY, rtol=0.02, atol=1e-6)


def test_rounded_times_change_no_bit():
    numbers = np.arange(12)
    told = [numbers / 30, np.round(numbers / 30 * 1000) / 1000]
    even, rounded = (followed(numbers, seconds) for seconds in told)
    np.testing.assert_array_equal(even.increments, rounded.increments)
    predicted = [one.predicted("ridge", seconds) for one, seconds in ((even, 12 / 30), (rounded, 0.4))]
    np.testing.assert_array_equal(*predicted)
    last = np.asarray(difference(SKELETON, at(10), at(11)))
    np.testing.assert_array_equal(even.increments[-1], last)  # as it is, divided by nothing


def test_a_swing_is_followed_through_a_gap():
    """Past a turning point the last step leads away; the autoregression comes back with it."""
    swing = lambda number: at(8 * np.sin(2 * np.pi * number / 20))  # noqa: E731
    history = followed(np.arange(25), np.arange(25) / 30, swing)
    elbow = SKELETON.dof_names.index("l_elbow_flex")
    true = np.asarray(difference(SKELETON, swing(24), swing(29)))[elbow]
    errors = {mode: abs(history.predicted(mode, 29 / 30)[elbow] - true) for mode in ("ridge", "velocity")}
    assert errors["ridge"] < 0.4 * errors["velocity"]


def test_nobody_is_predicted_for_long():
    history = followed(np.arange(10), np.arange(10) / 30)
    np.testing.assert_allclose(history.predicted("velocity", 3.0), 7.5 * WAY, rtol=1e-3)
    slow = after(SKELETON, None, 0.0, at(0), "same", 0.5)
    slow = after(SKELETON, slow, 0.5, at(1), "same")
    np.testing.assert_allclose(slow.predicted("velocity", 1.0), WAY, rtol=1e-3)


def test_frames_at_the_same_time_give_no_speed_beyond_measure():
    history = after(SKELETON, None, 0.0, at(0), "same", 1 / 30)
    history = after(SKELETON, history, 0.0005, at(1), "same")
    np.testing.assert_allclose(history.increments[-1], 2 * WAY, rtol=1e-3)
