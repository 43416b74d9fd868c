"""Feet that slide, stand, roll and fly at known speeds."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from box_figure import box_character

from jaxmocap.character import rest_pose
from jaxmocap.metrics import accelerations, foot_skate
from jaxmocap.motion import Motion, turned

CHARACTER = box_character()
TIMES = np.array([0.0, 0.1, 0.2, 0.25, 0.4, 0.5])


def moved(steps: np.ndarray) -> Motion:
    """The character at rest, carried along by (frame, 3) metres."""
    poses = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (len(steps), *leaf.shape)), rest_pose(CHARACTER.skeleton))
    poses = eqx.tree_at(lambda pose: pose.root, poses, poses.root.at[:, :3, 3].set(jnp.asarray(steps)))
    return Motion.from_poses(CHARACTER, poses, np.arange(len(steps)), TIMES[: len(steps)])


def test_a_character_that_slides_skates_at_its_speed_whatever_the_vertical_axis():
    motion = moved(TIMES[:, None] * [0.3, 0, 0.4])
    for upright in (motion, turned(motion, "z")):
        skate = foot_skate(upright)
        assert skate.speed.shape == (5, 2)
        np.testing.assert_allclose(skate.speed, 0.5, rtol=1e-3)
        assert skate.summary() == pytest.approx({"mean": 0.5, "p95": 0.5}, rel=1e-3)


def test_of_a_skeleton_without_feet_nothing_is_known():
    motion = moved(TIMES[:, None] * [0.3, 0, 0.4])
    skeleton = motion.character.skeleton
    names = tuple(name.replace("heel", "hoof") for name in skeleton.landmark_names)
    footless = replace(motion.character, skeleton=replace(skeleton, landmark_names=names))
    skate = foot_skate(replace(motion, character=footless))
    assert skate.speed.shape == (5, 2)
    assert np.isnan(skate.speed).all()
    assert skate.summary() == {}


def test_standing_still_is_no_skate_and_in_the_air_there_is_none():
    still = np.zeros((6, 3))
    assert foot_skate(moved(still)).summary() == {"mean": 0, "p95": 0}
    leap = still.copy()
    leap[2:4] = [[0.5, 0.3, 0], [0.6, 0.3, 0]]
    leap[4:] = [0.6, 0, 0]
    speed = foot_skate(moved(leap)).speed
    np.testing.assert_allclose(speed[[0, 4]], 0, atol=1e-4)  # the leap's take-off and landing are no standing either
    assert np.isnan(speed[1:4]).all()
    rising = np.arange(6)[:, None] * [0.1, 0.5, 0]
    assert foot_skate(moved(rising)).summary() == {}


def test_a_foot_may_turn_on_its_heel():
    motion = moved(np.zeros((6, 3)))
    toe, heel = (motion.joint_names.index(f"l_{point}") for point in ("toe", "heel"))
    joints = motion.joints.copy()
    joints[:, toe, 0] += TIMES
    turning = replace(motion, joints=joints)
    np.testing.assert_allclose(foot_skate(turning).speed, 0, atol=1e-4)
    joints[:, heel, 0] += 0.25 * TIMES
    np.testing.assert_allclose(foot_skate(replace(motion, joints=joints)).speed, [[0.25, 0]] * 5, atol=1e-3)


def test_one_frame_below_the_ground_does_not_lower_it():
    motion = moved(np.zeros((6, 3)))
    long = motion.joints[np.zeros(60, int)].copy()
    long[:, :, 0] += np.arange(60)[:, None] * 0.01
    long[30, :, 1] -= 0.5
    poses = {name: getattr(motion, name)[np.zeros(60, int)] for name in ("root", "angles", "confidence", "status")}
    clip = replace(motion, joints=long, frames=np.arange(60), timestamps=np.arange(60) / 10, **poses)
    speed = foot_skate(clip).speed
    np.testing.assert_allclose(speed, 0.1, rtol=1e-3)


def test_over_a_gap_in_which_a_foot_may_have_stepped_nothing_is_known():
    steps = np.array([0, 0, 0, 0.7, 0.7, 0.7])[:, None] * [1.0, 0, 0]
    motion = replace(moved(steps), timestamps=TIMES + [0, 0, 0, 1, 1, 1])
    speed = foot_skate(motion).speed
    assert np.isnan(speed[2]).all()
    np.testing.assert_allclose(np.delete(speed, 2, axis=0), 0, atol=1e-4)


def test_accelerations_between_uneven_frames_are_those_of_a_throw():
    times = np.array([0.0, 0.03, 0.04, 0.1, 0.11, 0.3])
    places = (times[:, None] * [3.0, 5.0, 0.0] - times[:, None] ** 2 * [0.0, 4.905, 0.0])[:, None]
    np.testing.assert_allclose(accelerations(places, times), np.tile([0, -9.81, 0], (4, 1, 1)), atol=1e-9)


@pytest.mark.parametrize(
    ("fps", "ticks", "missing"),
    [(60.0, 1000, []), (60.0, 1000, [3, 11, 12, 30, 31, 32]), (29.97, 600, [3, 11, 12, 30, 31, 32]), (240.0, 600, [])],
)
def test_rounded_times_of_an_even_rate_accelerate_nothing(fps, ticks, missing):
    """Whole milliseconds made 5 m/s^2 of an even walk at 60 frames a second."""
    numbers = np.delete(np.arange(100), missing)
    places = (numbers[:, None] / fps * [1.5, 0.0, 0.0])[:, None]
    assert np.abs(accelerations(places, np.round(numbers / fps * ticks) / ticks)).max() < 0.05


def test_a_single_frame_has_no_speed():
    assert foot_skate(moved(np.zeros((1, 3)))).speed.shape == (0, 2)
    assert foot_skate(moved(np.zeros((1, 3)))).summary() == {}
