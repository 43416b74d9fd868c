"""Summed area tables of changed tiles against counting."""

import importlib

import jax.numpy as jnp
import numpy as np

view_view = importlib.import_module("jaxmocap.energies._view_view")


def test_a_box_of_tiles_is_asked_for_marks():
    rng = np.random.default_rng(0)
    marks = rng.random((2, 9, 13)) < 0.02
    first = np.stack([rng.integers(0, 9, (9, 13)), rng.integers(0, 13, (9, 13))]).astype(np.int32)
    end = np.minimum(first + rng.integers(0, 6, first.shape), [[[9]], [[13]]]).astype(np.int32)
    tables = view_view._counted_up(jnp.asarray(marks))
    for table, view in zip(tables, marks, strict=True):
        expected = np.zeros((9, 13), bool)
        for place in np.ndindex(9, 13):
            (top, left), (bottom, right) = first[:, *place], end[:, *place]
            expected[place] = view[top:bottom, left:right].any()
        assert 0 < expected.sum() < expected.size
        np.testing.assert_array_equal(view_view._any_within(table, jnp.asarray(first), jnp.asarray(end)), expected)
