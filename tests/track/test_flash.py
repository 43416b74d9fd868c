"""A frame that a flash lights is passed over, and lies between its neighbours."""

import jax
import numpy as np
import pytest

from jaxmocap.capture import lit_apart
from jaxmocap.character import difference
from jaxmocap.energies import search_energy
from jaxmocap.motion import MotionHistory, after
from jaxmocap.observation import FrameImages
from jaxmocap.track import FrameTracker, Tracker, _frame
from jaxmocap.verdict import passed_over, poses_between


def lit(world, frame, rows=slice(None), by=2.0):
    """The frame with some rows in another light, in the second view only."""
    shown = world.shown(frame)
    images = [image.copy() for image in shown.images]
    images[1][rows] = np.clip(images[1][rows] * by, 0, 255).astype(np.uint8)
    return FrameImages(frame, shown.timestamp, images)


@pytest.mark.parametrize(
    ("rows", "by", "apart"),
    [(slice(None), 1.0, False), (slice(None), 1.1, False), (slice(None), 2.0, True), (slice(None), 0.5, True)]
    + [(slice(200, None), 2.0, True), (slice(0, 60), 2.0, True), (slice(100, 104), 2.0, False)],
)
def test_a_part_of_a_frame_in_another_light_is_noticed(world, rows, by, apart):
    """A rolling shutter lights some rows; the person and the camera move all the same."""
    assert lit_apart(lit(world, 2, rows, by).images, world.shown(0).images) == apart


@pytest.fixture
def tracker(world, monkeypatch):
    """One that finds the truth wherever it looks."""
    energy = search_energy(uncovered_scale=4.0, step=2, sampling="nearest", fail="ignore", outside="ignore")
    plain = Tracker(energy, None, None, flow_start=False, longest_flash=1)
    monkeypatch.setattr(_frame, "best_start", lambda score, tracker, frame, *rest: world.pose(frame.number))
    observations = world.observations()
    del observations.key_poses[1]
    tracker = FrameTracker(observations, plain, jax.random.key(0))
    return tracker, tracker.first(world.shown(0), world.pose(0)).state


def test_it_is_passed_over_and_lies_between_its_neighbours(world, tracker):
    tracker, state = tracker
    state, flash, revised = tracker.track(state, lit(world, 1))
    assert (flash.status, flash.energy, flash.confidence.max()) == ("doubtful", {}, 0.0)
    assert revised == ()
    state, result, (found,) = tracker.track(state, world.shown(2))
    assert result.status == "ok"
    assert (found.frame, found.status) == (1, "doubtful")
    skeleton = world.character.skeleton
    steps = [difference(skeleton, found.pose, world.pose(frame)) for frame in (0, 2)]
    np.testing.assert_allclose(steps[0], -steps[1], atol=1e-3)
    assert np.abs(steps[0]).max() > 0.02
    np.testing.assert_allclose(state.history.increments[0], state.history.increments[1])
    assert len(state.history.increments) == 2
    assert state.passed_over == ()


def test_a_selected_frame_is_known_in_any_light(world, tracker):
    tracker, state = tracker
    tracker.observations.key_poses[1] = world.pose(1)
    assert tracker.track(state, lit(world, 1)).result.energy != {}


def test_light_that_stays_is_taken_for_what_it_is(world, tracker):
    tracker, state = tracker
    state, result, _ = tracker.track(state, lit(world, 1))
    assert result.energy == {}
    assert tracker.track(state, lit(world, 2)).result.energy != {}


def test_frames_passed_over_lie_where_their_times_are(world):
    skeleton = world.character.skeleton
    gone = [passed_over(skeleton, FrameImages(n, n / 30, []), world.pose(0), 4) for n in (1, 2)]
    found = poses_between(skeleton, gone, world.pose(2), [0.25, 0.5])
    way = np.asarray(difference(skeleton, world.pose(0), world.pose(2)))
    for share, one in zip((0.25, 0.5), found, strict=True):
        np.testing.assert_allclose(difference(skeleton, world.pose(0), one.pose), share * way, atol=1e-4)


def test_a_missing_frame_counts_as_one_passed_over(world, tracker):
    """The frame is not there at all: what moved in two intervals is no speed of one."""
    tracker, state = tracker
    state, result, revised = tracker.track(state, world.shown(2))
    assert (result.frame, revised) == (2, ())
    skeleton = world.character.skeleton
    whole = np.asarray(difference(skeleton, world.pose(0), world.pose(2)))
    np.testing.assert_allclose(state.history.increments, np.stack([whole / 2] * 2), atol=1e-6)


def test_after_a_gap_the_motion_counts_per_frame(world):
    skeleton, window = world.character.skeleton, (np.full(39, 0.01, np.float32),) * 8
    begin, end = world.shown(0).timestamp, world.shown(2).timestamp
    past = MotionHistory(begin, world.pose(0), window, (end - begin) / 2)
    np.testing.assert_allclose(past.predicted("velocity", end), 0.02, rtol=1e-5)
    following = after(skeleton, past, end, world.pose(2), "same")
    whole = np.asarray(difference(skeleton, world.pose(0), world.pose(2)))
    np.testing.assert_allclose(following.increments[-2:], np.stack([whole / 2] * 2))
