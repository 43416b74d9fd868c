"""Where the last motion leads is tried limb by limb."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmocap.character import clamp, retract
from jaxmocap.energies import search_energy
from jaxmocap.motion import MotionHistory
from jaxmocap.track import FrameTracker, Tracker
from jaxmocap.track._start import best_start

FRAME = 2


@pytest.fixture(scope="module")
def trackers(world):
    energy = search_energy(uncovered_scale=4.0, step=2, sampling="nearest", fail="ignore", outside="ignore")
    return {
        prediction: FrameTracker(
            world.observations(), Tracker(energy, None, None, prediction=prediction), jax.random.key(0)
        )
        for prediction in (True, False)
    }


def moved(world, **degrees):
    """An increment, and the pose from which it leads to the truth, as far as the joint limits allow."""
    skeleton = world.character.skeleton
    step = np.zeros(39, np.float32)
    for name, value in degrees.items():
        step[skeleton.dof_names.index(name)] = np.deg2rad(value)
    return step, clamp(skeleton, retract(skeleton, world.pose(FRAME), jnp.asarray(-step)))


def started(world, tracker, pose, step):
    past = MotionHistory(world.shown(FRAME - 1).timestamp, pose, (np.asarray(step),))
    registered = tracker.observations.key_poses.get(FRAME)
    frame = world.frame(FRAME, observations=tracker.observations)
    return best_start(tracker.score, tracker.tracker, frame, pose, past, registered)


@pytest.mark.slow
def test_a_limb_that_goes_on_as_before_is_found_at_its_place(world, trackers):
    step, before = moved(world, l_shoulder_abd=25, r_knee_flex=20)
    found = started(world, trackers[True], before, step)
    truth = np.asarray(world.pose(FRAME).angles)
    index = world.character.skeleton.dof_names.index("l_shoulder_abd") - 6
    assert abs(float(before.angles[index]) - truth[index]) > np.deg2rad(20)
    np.testing.assert_allclose(found.angles, truth, atol=np.deg2rad(8))
    assert started(world, trackers[False], before, step) is before


def test_a_limb_that_stopped_stays_while_another_one_goes_on(world, trackers):
    step, before = moved(world, l_shoulder_abd=25)
    right = world.character.skeleton.dof_names.index("r_shoulder_abd")
    step[right] = np.deg2rad(-40)
    found = started(world, trackers[True], before, step)
    assert float(found.angles[right - 6]) == pytest.approx(float(world.pose(FRAME).angles[right - 6]), abs=1e-6)
    left = world.character.skeleton.dof_names.index("l_shoulder_abd") - 6
    assert float(found.angles[left]) == pytest.approx(float(world.pose(FRAME).angles[left]), abs=1e-4)
