"""The run-time checks of array annotations are on, and look at arrays only."""

import jax.numpy as jnp
import jaxtyping
import numpy as np
import pytest

from jaxmocap.geometry import so3_exp
from jaxmocap.samplers import particles_for


def test_a_wrong_shape_is_refused():
    with pytest.raises(jaxtyping.TypeCheckError, match="vector"):
        so3_exp(jnp.ones((5, 2)))


def test_a_wrong_kind_is_refused():
    with pytest.raises(jaxtyping.TypeCheckError, match="vector"):
        so3_exp(jnp.ones((5, 3), int))


def test_numpy_passes_where_jax_takes_it_and_other_types_are_left_alone():
    assert so3_exp(np.ones((5, 3), np.float32)).shape == (5, 3, 3)
    assert particles_for(np.int64(6)) == 104
