"""Times of frames as containers write them, with frames missing, and with a rate that varies."""

import numpy as np
import pytest

from jaxmocap.motion import evened, usual_interval
from jaxmocap.motion._frame_times import frames_apart

MISSING = np.array([0, 1, 2, 5, 6, 10, 11, 12, 13, 20, 21, 23, 24, 25])
"""Numbers of the frames that are left."""


@pytest.mark.parametrize("fps", [23.976, 25.0, 29.97, 30.0, 50.0, 60.0, 240.0])
def test_even_times_are_one_step_apart_and_stay_to_the_bit(fps):
    times = np.arange(300) / fps
    assert usual_interval(times) == pytest.approx(1 / fps)
    assert set(frames_apart(np.diff(times), usual_interval(times))) == {1.0}
    np.testing.assert_array_equal(evened(times), times)


ALL, SOME = np.arange(300), np.concatenate([MISSING + 26 * turn for turn in range(10)])


@pytest.mark.parametrize(
    ("fps", "ticks", "numbers"),
    [(30, 1000, ALL), (60, 1000, ALL), (240, 1000, ALL), (29.97, 600, ALL), (240, 600, ALL)]
    + [(30, 1000, SOME), (60, 1000, SOME), (240, 1000, SOME), (29.97, 600, SOME)],
)
def test_what_a_container_rounds_is_taken_out(fps, ticks, numbers):
    times = np.round(numbers / fps * ticks) / ticks
    steps = frames_apart(np.diff(times), usual_interval(times))
    np.testing.assert_array_equal(steps, np.diff(numbers))
    off = [np.abs(np.diff(found) - np.diff(numbers) / fps).max() for found in (times, evened(times))]
    assert off[0] > 0.3 / ticks
    assert off[1] < 0.05 * off[0]


def test_where_frames_are_missing_intervals_are_whole_numbers_of_the_usual_one():
    times = MISSING / 30
    assert usual_interval(times) == pytest.approx(1 / 30)
    np.testing.assert_array_equal(frames_apart(np.diff(times), 1 / 30), np.diff(MISSING))
    np.testing.assert_array_equal(frames_apart(np.diff(times[::-1]), 1 / 30), np.diff(MISSING)[::-1])
    np.testing.assert_array_equal(evened(times), times)


def test_most_frames_missing_do_not_make_the_usual_interval_longer():
    numbers = np.cumsum([0, *[3, 2, 1, 4, 2, 5, 2, 3] * 10])
    assert np.median(np.diff(numbers)) > 2
    assert usual_interval(numbers / 60) == pytest.approx(1 / 60)


def test_a_rate_that_varies_is_taken_as_it_is():
    rng = np.random.default_rng(0)
    times = np.concatenate([[0.0], np.cumsum(rng.uniform(0.025, 0.045, 100))])
    np.testing.assert_array_equal(evened(times), times)
    counted = np.round(times * 1000) / 1000
    np.testing.assert_allclose(evened(counted), counted, atol=5e-4)
    interval = usual_interval(times)
    steps = frames_apart(np.diff(times), interval)
    np.testing.assert_allclose(steps, np.diff(times) / interval, atol=1 / 600 / interval)
    assert len(set(steps)) > 50


def test_pairs_of_frames_at_nearly_the_same_time_do_not_make_the_interval_short():
    times = np.sort(np.concatenate([np.arange(50) / 30, np.arange(0, 50, 4) / 30 + 0.0005]))
    assert 0.005 < usual_interval(times) < 0.05


def test_few_frames():
    assert usual_interval(np.array([0.4])) == 0
    np.testing.assert_array_equal(evened(np.array([0.4])), [0.4])
    assert usual_interval(np.array([0.4, 0.5])) == pytest.approx(0.1)
