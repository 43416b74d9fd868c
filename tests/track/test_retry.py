"""A limb that the search has folded behind the body is searched again."""

import jax
import numpy as np
import pytest
from perturbed import moved, vertex_errors

from jaxmocap.energies import search_energy
from jaxmocap.track import Effort, FrameTracker, Retry, SearchPlan, Tracker
from jaxmocap.track._economy import seen_shares
from jaxmocap.track._score import look_at

FRAME = 2
BEHIND = {"l_shoulder_flex": -26, "l_shoulder_abd": -88, "l_shoulder_axial": 77, "l_elbow_flex": -47}
"""Degrees that bring the left forearm where no camera sees it."""


def searched_again(world, retry, usual=0.0, settle=lambda pose: pose):
    energy = search_energy(uncovered_scale=4.0, step=2, sampling="nearest", fail="ignore", outside="ignore")
    plan = SearchPlan((Effort(2, 12),), particles=64, wide=0.25, retry=retry)
    search = FrameTracker(world.observations(), Tracker(energy, plan, refine=None), jax.random.key(0)).search
    start, problem = moved(world, FRAME, **BEHIND), world.problem(FRAME)
    search.left.append(usual)
    seen = look_at(world.character, start, problem)
    assert seen_shares(search.outer_bodies, world.character, search.face_bodies, seen.over)[0] < 0.2
    return start, search._again(retry, start, start, problem, FRAME, settle)


def test_an_arm_that_no_view_shows_is_found(world):
    """Nothing but its being hidden may call for the search: the other reasons are switched off."""
    start, found = searched_again(world, Retry(foreign=2.0, uncovered=2.0))
    assert vertex_errors(world, FRAME, start).max() > 0.3
    assert vertex_errors(world, FRAME, found).max() < 0.06


def test_what_always_stays_uncovered_calls_for_nothing(world):
    """Hidden or foreign limbs aside, the uncovered arm is searched for unless as much was uncovered before."""
    for usual, moves in ((0.0, True), (1.0, False)):
        start, found = searched_again(world, Retry(hidden=0.0, foreign=2.0, unusual=0.5), usual)
        assert bool(np.any(found.angles != start.angles)) == moves


def test_it_stays_where_nothing_calls_for_it(world):
    start, found = searched_again(world, Retry(hidden=0.0, foreign=2.0, uncovered=2.0))
    np.testing.assert_array_equal(found.angles, start.angles)


@pytest.mark.parametrize(("spoiled", "moves"), [(None, False), ("hidden", True), ("seen", False)])
def test_what_follows_decides_between_a_hidden_limb_and_one_that_is_seen(world, spoiled, moves):
    """No answer gains enough by itself; what settles both makes them equal, or one of them worse."""
    retry, truth, wrong = Retry(margin=9.0, slack=9.0), world.pose(FRAME), moved(world, FRAME, l_hip_flex=40)
    asked = []

    def settle(pose):
        asked.append(pose)
        return wrong if spoiled == ("hidden", "seen")[len(asked) - 1] else truth

    start, found = searched_again(world, retry, settle=settle)
    assert len(asked) == 2
    np.testing.assert_array_equal(asked[0].angles, start.angles)
    assert bool(np.any(found.angles != start.angles)) == moves


def test_a_limb_that_is_seen_must_not_cost_too_much(world):
    start, found = searched_again(world, Retry(margin=9.0, slack=-9.0))
    np.testing.assert_array_equal(found.angles, start.angles)
