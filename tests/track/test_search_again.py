"""A limb that the search has folded behind the body is searched again."""

import jax
import numpy as np
import pytest
from perturbed import moved, vertex_errors

from jaxmocap import InputError
from jaxmocap.energies import search_energy
from jaxmocap.search import BodySearch, Retry, SearchPlan
from jaxmocap.track import FrameTracker, Tracker, _search_again
from jaxmocap.track._search_again import search_again

FRAME = 2
BEHIND = {"l_shoulder_flex": -26, "l_shoulder_abd": -88, "l_shoulder_axial": 77, "l_elbow_flex": -47}
"""Degrees that bring the left forearm where no camera sees it."""


def body_search(world, retry):
    energy = search_energy(uncovered_scale=4.0, step=2, sampling="nearest", fail="ignore", outside="ignore")
    plan = SearchPlan(step=2, iterations=12, particles=64, wide=0.25, retry=retry)
    return FrameTracker(world.observations(), Tracker(energy, plan, refine=None), jax.random.key(0)).body_search


def filmed(world):
    """The frame as the tracker has it, with the colours of the filled up mesh."""
    return world.frame(FRAME, observations=world.observations().filled_up())


def searched_again(world, retry, usual=0.0, last_seen=None, before=0):
    """A start with a hidden arm, and where the search comes from there; its limbs were searched again in so many frames
    `before`."""
    search, start, frame = body_search(world, retry), moved(world, FRAME, **BEHIND), filmed(world)
    memory = search.start()._replace(searched_again=np.full(4, before), uncovered=(usual,), last_seen=(last_seen,) * 4)
    assert search.evidence.limb_shares(search.evidence.draw(start, frame.problem))[0] < 0.2
    return start, search_again(search, None, retry, frame, start, start, None, memory)[0]


@pytest.mark.slow
def test_an_arm_that_no_view_shows_is_found(world):
    """Nothing but its being hidden may call for the search: the other reasons are switched off."""
    start, found = searched_again(world, Retry(foreign=2.0, uncovered=2.0))
    assert vertex_errors(world, FRAME, start).max() > 0.3
    assert vertex_errors(world, FRAME, found).max() < 0.06


@pytest.mark.slow
def test_what_always_stays_uncovered_calls_for_nothing(world):
    """Hidden or foreign limbs aside, the uncovered arm is searched for unless as much was uncovered before."""
    for usual, moves in ((0.0, True), (1.0, False)):
        start, found = searched_again(world, Retry(hidden=0.0, foreign=2.0, unusual=0.5), usual)
        assert bool(np.any(found.angles != start.angles)) == moves


@pytest.mark.parametrize("retry", [Retry(hidden=0.0, foreign=2.0, uncovered=2.0), Retry(tries=0)])
def test_it_stays_where_nothing_calls_for_it(world, retry):
    start, found = searched_again(world, retry)
    np.testing.assert_array_equal(found.angles, start.angles)


@pytest.mark.parametrize(
    ("rise", "worse", "asks", "moves"),
    [
        (0.0005, None, False, True),
        (0.005, "hidden", True, True),
        (0.005, "seen", True, False),
        (0.005, None, True, True),
        (0.02, "hidden", False, False),
    ],
)
def test_a_hidden_limb_gives_way_to_one_that_is_seen(world, rise, worse, asks, moves):
    """By what it costs more; where that is not decided, by which of the two is worse once they are refined."""
    hidden, shown, wrong = moved(world, FRAME, **BEHIND), world.pose(FRAME), moved(world, FRAME, l_hip_flex=40)
    asked, totals = [], np.array([0.5, 0.5 + rise, 9.0])

    def refinement(frame, pose, history):
        asked.append(pose)
        return (wrong if worse == ("hidden", "seen")[len(asked) - 1] else shown), None

    retry, frame = Retry(), filmed(world)
    search, poses = body_search(world, retry), [hidden, shown, shown]
    taken = _search_again._shown(search, refinement, retry, 0, frame, poses, totals, None)
    assert len(asked) == 2 * asks
    assert taken is (shown if moves else hidden)


@pytest.fixture
def begun(monkeypatch):
    """The searches that were begun: the number of the group and the pose; each of them finds where it began."""
    begun = []
    monkeypatch.setattr(
        BodySearch,
        "group",
        lambda self, number, pose, *rest, **more: (begun.append((number, pose)) or pose, np.zeros(39)),
    )
    return begun


@pytest.mark.parametrize(("before", "begins"), [(0, 4), (1, 2), (2, 2)])
def test_limbs_of_the_frame_before_take_turns(world, begun, before, begins):
    """All searches in the first frame, then half of them, one from where the limb was last seen."""
    retry = Retry(foreign=2.0, uncovered=2.0, tries=2, turns=2)
    start, _ = searched_again(world, retry, last_seen=world.pose(FRAME - 1), before=before)
    assert len({number for number, _ in begun}) == 1
    assert [bool(np.any(pose.angles != start.angles)) for _, pose in begun] == sorted([False, True] * (begins // 2))


def test_a_limb_that_was_left_alone_has_all_its_searches_again(world, begun):
    search, frame = body_search(world, Retry()), filmed(world)
    counts, memory = [], search.start()
    for pose in (moved(world, FRAME, **BEHIND),) * 2 + (world.pose(FRAME), moved(world, FRAME, **BEHIND)):
        begun.clear()
        retry = Retry(foreign=2.0, uncovered=2.0)
        _, memory = search_again(search, None, retry, frame, pose, pose, None, memory)
        counts.append(len(begun))
    assert counts == [3, 1, 0, 3]


def test_take_turns_of_no_frames_is_refused():
    with pytest.raises(InputError, match="turns of 0 frames"):
        Retry(turns=0)


def test_a_hidden_limb_is_also_searched_from_where_it_was_last_seen(world, begun):
    before, arm = world.pose(FRAME - 1), np.array(world.character.skeleton.group("l_arm")) - 6
    retry = Retry(foreign=2.0, uncovered=2.0, tries=2)
    start, _ = searched_again(world, retry, last_seen=before)
    assert len({number for number, _ in begun}) == 1
    for (_, pose), expected in zip(begun, (start, start, before, before), strict=True):
        np.testing.assert_allclose(pose.angles[arm], expected.angles[arm], atol=1e-6)
        np.testing.assert_array_equal(np.delete(pose.angles, arm), np.delete(start.angles, arm))
