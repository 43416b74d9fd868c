"""The smallest cut of a grid against all labellings."""

import itertools

import numpy as np
import pytest

from jaxmocap.baselines import GridCut


def energy_of(labels, picture, contrast, constant, one, zero):
    """What a labelling costs, by the formula, pair by pair; the cut counts in hundredths of a nat."""
    height, width = labels.shape
    pairs = [
        ((i, j), (i + down, j + right))
        for down, right in ((0, 1), (1, 0), (1, 1), (1, -1))
        for i, j in np.ndindex(height - down, width)
        if 0 <= j + right < width
    ]
    gaps = np.array([((picture[a] - picture[b]) ** 2).sum() for a, b in pairs])
    alike = contrast * np.exp(-gaps / (2 * gaps.mean())) + constant
    weights = alike / [np.hypot(a[0] - b[0], a[1] - b[1]) for a, b in pairs]
    cut = np.array([labels[a] != labels[b] for a, b in pairs])
    return np.where(labels, one.round(2), zero.round(2)).sum() + weights[cut].round(2).sum()


@pytest.mark.parametrize("seed", range(4))
def test_no_labelling_of_a_small_picture_costs_less(seed):
    rng = np.random.default_rng(seed)
    picture = rng.random((3, 4, 3))
    cut = GridCut(picture, contrast=2.0, constant=0.3)
    one, zero = rng.normal(0, 2, (2, 3, 4))
    every = [np.array(bits).reshape(3, 4) > 0 for bits in itertools.product((0, 1), repeat=12)]
    least = min(energy_of(labels, picture, 2.0, 0.3, one, zero) for labels in every)
    assert cut.energy(one, zero) == pytest.approx(least, abs=1e-9)
    assert energy_of(cut.labels(one, zero), picture, 2.0, 0.3, one, zero) == pytest.approx(least, abs=1e-9)


def test_the_reported_energy_is_that_of_the_labels():
    rng = np.random.default_rng(0)
    picture = rng.random((24, 30, 3))
    cut = GridCut(picture, contrast=1.0, constant=0.1)
    one = rng.normal(0, 5, (24, 30))
    labels = cut.labels(one, np.zeros((24, 30)))
    assert cut.energy(one, np.zeros((24, 30))) == pytest.approx(
        energy_of(labels, picture, 1.0, 0.1, one, 0 * one), abs=1e-6
    )
    assert 0 < labels.mean() < 1


def test_without_neighbours_every_pixel_takes_its_cheaper_label():
    one = np.random.default_rng(1).normal(0, 3, (5, 6))
    cut = GridCut(np.zeros((5, 6, 3)), contrast=0.0, constant=0.0)
    np.testing.assert_array_equal(cut.labels(one, np.zeros((5, 6))), one < 0)
