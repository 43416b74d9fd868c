"""Statistics on numbers whose answers are known."""

import numpy as np
import pytest

from jaxmocap.experiments import compare, fewest_pairs, paired_difference, summary


def test_summary_leaves_out_what_is_not_known():
    found = summary([3.0, None, 1.0, float("nan"), 2.0])
    assert (found.count, found.median) == (3, 2.0)
    assert (found.low, found.high) == (1.5, 2.5)
    assert summary([]).count == 0
    assert np.isnan(summary([None]).median)


def test_a_constant_gap_has_an_interval_of_no_width():
    ours = np.array([1.0, 5.0, 2.0, 9.0, 4.0, 3.0])
    found = paired_difference(ours, ours + 0.5)
    assert (found.pairs, found.median, found.low, found.high) == (6, 0.5, 0.5, 0.5)
    assert found.sure


def test_noise_around_zero_is_not_sure_and_a_clear_gap_is():
    rng = np.random.default_rng(0)
    ours, noise = rng.uniform(1, 10, 40), rng.normal(0, 1, 40)
    assert not paired_difference(ours, ours + noise - np.median(noise)).sure
    clear = paired_difference(ours, ours + noise + 2.0)
    assert clear.sure
    assert clear.low < clear.median < clear.high


def test_the_interval_covers_the_true_median_about_as_often_as_it_says():
    rng = np.random.default_rng(1)
    inside = 0
    for trial in range(200):
        found = paired_difference(np.zeros(25), rng.normal(1.0, 1.0, 25), share=0.9, seed=trial)
        inside += found.low <= 1.0 <= found.high
    assert 0.82 <= inside / 200 <= 0.98


@pytest.mark.parametrize("pairs", [1, 2, 3, 5, 6, 8])
def test_methods_that_are_alike_are_seldom_told_apart_however_few_the_pairs(pairs):
    """At most in one of twenty comparisons, and by chance a few more."""
    rng = np.random.default_rng(pairs)
    told = sum(paired_difference(np.zeros(pairs), rng.normal(size=pairs), seed=trial).sure for trial in range(200))
    assert told <= 0.1 * 200


def test_the_fewest_pairs_are_those_whose_extremes_hold_the_median_so_often():
    for share, fewest in ((0.5, 2), (0.9, 5), (0.9375, 5), (0.95, 6), (0.99, 8)):
        assert fewest_pairs(share) == fewest
        assert 1 - 2.0 ** (1 - fewest) >= share > 1 - 2.0 ** (2 - fewest)
    few, enough = (paired_difference(np.zeros(count), np.arange(1.0, 1 + count)) for count in (5, 6))
    assert (few.pairs, few.median, few.sure) == (5, 3.0, False)
    assert np.isnan([few.low, few.high]).all()
    assert enough.sure


def test_one_pair_has_no_interval_and_unknown_errors_no_pair():
    assert paired_difference(np.array([1.0]), np.array([2.0])).pairs == 1
    assert not paired_difference(np.array([1.0]), np.array([2.0])).sure
    assert paired_difference(np.array([np.nan, 1.0]), np.array([2.0, np.nan])).pairs == 0


def row(capture, seed, error, status="done"):
    return {"capture": capture, "seed": seed, "marker_error_cm": error, "status": status}


def test_rows_are_paired_by_capture_and_seed():
    ours = [row("a", 0, 1.0), row("b", 0, 10.0), row("a", 1, 2.0), row("c", 0, 1.0)]
    theirs = [row("b", 0, 13.0), row("a", 1, 5.0), row("a", 0, 4.0), row("c", 0, None, "failed")]
    found = compare(ours, theirs, "marker_error_cm")
    assert (found.pairs, found.median) == (2, 3.0)
    alone = compare(
        [row("a", seed, 0.0) for seed in range(3)], [row("a", seed, 1.0 + seed) for seed in range(3)], "marker_error_cm"
    )
    assert (alone.pairs, alone.median) == (3, 2.0)


def test_seeds_of_a_capture_do_not_make_a_difference_surer():
    """Captures differ by centimetres and seeds by millimetres: the interval is that of the captures."""
    rng, called = np.random.default_rng(0), 0
    for _ in range(100):
        gaps = rng.normal(0.0, 3.0, 6)[:, None] + rng.normal(0.0, 0.3, (6, 3))
        ours, theirs = (
            [row(str(c), s, factor * gaps[c, s]) for c in range(6) for s in range(3)] for factor in (0.0, 1.0)
        )
        called += compare(ours, theirs, "marker_error_cm").sure
    assert called <= 12
