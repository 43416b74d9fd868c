"""The run-time checks of array annotations are on, and look at arrays only."""

import jax.numpy as jnp
import jaxtyping
import numpy as np
import pytest

from jaxmocap.camera import project
from jaxmocap.samplers import particles_for

EYE3, EYE4 = jnp.eye(3), jnp.eye(4)


def test_a_wrong_shape_is_refused():
    with pytest.raises(jaxtyping.TypeCheckError, match="points"):
        project(EYE3, EYE4, jnp.ones((5, 2)))


def test_a_wrong_kind_is_refused():
    with pytest.raises(jaxtyping.TypeCheckError, match="points"):
        project(EYE3, EYE4, jnp.ones((5, 3), int))


def test_numpy_passes_where_jax_takes_it_and_other_types_are_left_alone():
    pixels, _ = project(EYE3, EYE4, np.ones((5, 3), np.float32))
    assert pixels.shape == (5, 2)
    assert particles_for(np.int64(6)) == 104
