"""Eq. 10 for a frame that follows a gap: that of the missing frames, too, at its least over where these may be."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import minimize

from jaxmocap.motion import MotionHistory
from jaxmocap.refinement import Refinement, RefinePlan

STEP = np.full(39, 0.02, np.float32)


@pytest.fixture(scope="module")
def prior(world):
    """The prior of a frame so many intervals after the last one."""
    refinement = Refinement(world.observations(), RefinePlan())
    pose = world.pose(0)
    history = MotionHistory(0.0, pose, (STEP, STEP), 1 / 30)
    return lambda steps: refinement._motion_prior(pose, history, steps / 30)


def eq10(way: float, missing: int, l1: float, weight: float, step: float) -> float:
    """Minimise the sum of Eq. 10 over the increments of the missing frames and the last one, which lead as far as
    `way`; each is predicted to be as the one before, the first as `step`. The L1 is smoothed by a nanometre."""

    def energy(free):
        increments = np.append(free, way - free.sum())
        before = np.insert(increments[:-1], 0, step)
        return np.sum(l1 * np.sqrt(increments**2 + 1e-18) + weight * (increments - before) ** 2)

    return minimize(energy, np.full(missing, way / (missing + 1)), method="BFGS", options={"gtol": 1e-10}).fun


@pytest.mark.parametrize("missing", [1, 3])
def test_it_costs_what_eq_10_costs_over_all_frames_between(prior, missing):
    steps = missing + 1
    one, several = prior(1), prior(steps)
    np.testing.assert_allclose(several.target, steps * STEP, rtol=1e-5)
    assert jnp.array_equal(one.l1, several.l1)
    for share in (0.5, 1.0, 1.5, 2.0):
        way = share * steps * float(STEP[0])
        for dof in (0, 20):
            l1, weight, target = (float(leaf[dof]) for leaf in (several.l1, several.weight, several.target))
            expected = eq10(way, missing, float(one.l1[dof]), float(one.weight[dof]), float(STEP[dof]))
            assert l1 * abs(way) + weight * (way - target) ** 2 == pytest.approx(expected, rel=1e-3)


def test_times_that_a_container_rounded_change_no_bit(prior):
    even, rounded = prior(1), prior(34 / 1000 * 30)
    for one, other in zip(even, rounded, strict=True):
        np.testing.assert_array_equal(one, other)


def test_without_a_gap_it_is_eq_10(prior):
    plan, found = RefinePlan(), prior(1)
    unit = np.repeat([2.0, 1.0], [3, 36])
    np.testing.assert_array_equal(found.target, STEP)
    np.testing.assert_array_equal(found.l1, np.float32(plan.weights.regularisation) * unit)
    np.testing.assert_array_equal(found.weight, np.float32(plan.weights.regularisation) * unit**2)
