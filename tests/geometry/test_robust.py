"""Huber's penalty: known values, and a weight that is the derivative over twice the residual."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxmocap.geometry import huber, huber_weight


def test_weight_times_residual_is_half_the_derivative():
    residuals = jnp.array([-3.0, -0.4, -0.01, 0.0, 0.02, 0.5, 7.0])
    slopes = jax.vmap(jax.grad(lambda e: huber(e, 0.5)))(residuals)
    np.testing.assert_allclose(2 * huber_weight(residuals, 0.5) * residuals, slopes, rtol=1e-5, atol=1e-7)


def test_small_residuals_are_squared_with_weight_one():
    np.testing.assert_allclose(huber(jnp.asarray(1e-3), 1.0), 1e-6, rtol=1e-4)
    np.testing.assert_allclose(huber_weight(jnp.asarray(1e-3), 1.0), 1.0, rtol=1e-4)


def test_huber_grows_linearly_and_joins_smoothly():
    np.testing.assert_allclose(huber(jnp.asarray(-5.0), 2.0), 2 * 2 * 5 - 4)
    np.testing.assert_allclose(huber(jnp.asarray(2.0), 2.0), 4.0)
