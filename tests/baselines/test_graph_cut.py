"""The smallest cut of a grid against all labellings."""

import itertools

import numpy as np
import pytest

from jaxmocap.baselines import GridCut


@pytest.mark.parametrize("seed", range(4))
def test_no_labelling_of_a_small_picture_costs_less(seed):
    rng = np.random.default_rng(seed)
    cut = GridCut(rng.random((3, 4, 3)), contrast=2.0, constant=0.3)
    one, zero = rng.normal(0, 2, (2, 3, 4))
    every = [np.array(bits).reshape(3, 4) > 0 for bits in itertools.product((0, 1), repeat=12)]
    least = min(cut.energy_of(labels, one, zero) for labels in every)
    assert cut.energy(one, zero) == pytest.approx(least, abs=1e-9)
    assert cut.energy_of(cut.labels(one, zero), one, zero) == pytest.approx(least, abs=1e-9)


def test_the_reported_energy_is_that_of_the_labels():
    rng = np.random.default_rng(0)
    picture = rng.random((24, 30, 3))
    cut = GridCut(picture, contrast=1.0, constant=0.1)
    one = rng.normal(0, 5, (24, 30))
    labels = cut.labels(one, np.zeros((24, 30)))
    assert cut.energy(one, np.zeros((24, 30))) == pytest.approx(cut.energy_of(labels, one, 0 * one), abs=1e-6)
    assert 0 < labels.mean() < 1


def test_without_neighbours_every_pixel_takes_its_cheaper_label():
    one = np.random.default_rng(1).normal(0, 3, (5, 6))
    cut = GridCut(np.zeros((5, 6, 3)), contrast=0.0, constant=0.0)
    np.testing.assert_array_equal(cut.labels(one, np.zeros((5, 6))), one < 0)
