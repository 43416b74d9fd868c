"""Robust penalties: known values, and weights that are the derivative over twice the residual."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmocap.geometry import geman_mcclure, geman_mcclure_weight, huber, huber_weight

PAIRS = [(geman_mcclure, geman_mcclure_weight), (huber, huber_weight)]


@pytest.mark.parametrize(("penalty", "weight"), PAIRS)
def test_weight_times_residual_is_half_the_derivative(penalty, weight):
    residuals = jnp.array([-3.0, -0.4, -0.01, 0.0, 0.02, 0.5, 7.0])
    slopes = jax.vmap(jax.grad(lambda e: penalty(e, 0.5)))(residuals)
    np.testing.assert_allclose(2 * weight(residuals, 0.5) * residuals, slopes, rtol=1e-5, atol=1e-7)


@pytest.mark.parametrize(("penalty", "weight"), PAIRS)
def test_small_residuals_are_squared_with_weight_one(penalty, weight):
    np.testing.assert_allclose(penalty(jnp.asarray(1e-3), 1.0), 1e-6, rtol=1e-4)
    np.testing.assert_allclose(weight(jnp.asarray(1e-3), 1.0), 1.0, rtol=1e-4)


def test_geman_mcclure_saturates_at_the_squared_scale():
    np.testing.assert_allclose(geman_mcclure(jnp.asarray(1e4), 0.3), 0.09, rtol=1e-5)
    np.testing.assert_allclose(geman_mcclure(jnp.asarray(0.3), 0.3), 0.045, rtol=1e-5)


def test_huber_grows_linearly_and_joins_smoothly():
    np.testing.assert_allclose(huber(jnp.asarray(-5.0), 2.0), 2 * 2 * 5 - 4)
    np.testing.assert_allclose(huber(jnp.asarray(2.0), 2.0), 4.0)
