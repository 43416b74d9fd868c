"""Polish: downhill on the soft Eq. 5, from near the truth to the truth."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxmocap.character import landmark_positions, retract
from jaxmocap.energies import search_energy
from jaxmocap.render import SoftSettings
from jaxmocap.search import PolishPlan, polish

FRAME = 2
PLAN = PolishPlan(steps=25)


def error(world, pose):
    """Mean distance of the joints from the truth in metres."""
    found = np.asarray(landmark_positions(world.character.skeleton, pose))
    return np.linalg.norm(found - world.truth.joints[FRAME], axis=1).mean()


@pytest.fixture(scope="module")
def polished(world):
    spread = np.where(np.arange(39) < 3, 0.01, 0.03)
    away = np.random.default_rng(1).normal(0, spread).astype(np.float32)
    start = retract(world.character.skeleton, world.pose(FRAME), jnp.asarray(away))
    return start, *polish(search_energy(), world.character, start, world.problem(FRAME), PLAN)


@pytest.mark.slow
def test_three_centimetres_become_less_than_one(world, polished):
    start, pose, before, after = polished
    assert error(world, start) > 0.025
    assert error(world, pose) < 0.01
    assert after < before


@pytest.mark.slow
def test_joint_limits_hold(world, polished):
    skeleton = world.character.skeleton
    angles = np.asarray(polished[1].angles)
    assert np.all((angles >= skeleton.lower - 1e-5) & (angles <= skeleton.upper + 1e-5))


@pytest.mark.slow
def test_bounds_that_are_too_small_change_nothing(world, polished):
    start, pose, _, after = polished
    small = PolishPlan(steps=25, soft=SoftSettings(windows=64, pixels=256, shares=256))
    again, _, energy = polish(search_energy(), world.character, start, world.problem(FRAME), small)
    assert energy == after
    np.testing.assert_array_equal(again.angles, pose.angles)
