"""Coordinate descent on problems with known solutions."""

import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import lsq_linear

from jaxmocap.refiners import shooting


def problem(size=12, rows=40):
    """(A, y) of |A x - y|^2 and its normal matrices."""
    rng = np.random.default_rng(0)
    matrix, target = rng.normal(size=(rows, size)), rng.normal(size=rows)
    return matrix, target, jnp.asarray(matrix.T @ matrix), jnp.asarray(matrix.T @ target)


def test_separable_problem_has_the_soft_threshold_at_half_lambda():
    hessian, gradient = jnp.diag(jnp.array([2.0, 2.0, 2.0])), jnp.array([4.0, 1.4, -3.0])
    wide = jnp.full(3, 100.0)
    found = shooting(hessian, gradient, 3.0, -wide, wide, jnp.zeros(3))
    np.testing.assert_allclose(found, [(4 - 1.5) / 2, 0.0, -(3 - 1.5) / 2], atol=1e-12)


def test_without_l1_and_limits_it_solves_the_linear_system():
    _, _, hessian, gradient = problem()
    wide = jnp.full(12, jnp.inf)
    found = shooting(hessian, gradient, 0.0, -wide, wide, jnp.zeros(12), sweeps=2000, tolerance=1e-13)
    np.testing.assert_allclose(found, jnp.linalg.solve(hessian, gradient), atol=1e-9)


def test_box_without_l1_equals_scipy():
    matrix, target, hessian, gradient = problem()
    lower, upper = jnp.full(12, -0.05), jnp.full(12, 0.1)
    found = shooting(hessian, gradient, 0.0, lower, upper, jnp.zeros(12), sweeps=2000, tolerance=1e-13)
    expected = lsq_linear(matrix, target, (lower, upper), tol=1e-14).x
    assert jnp.any(found == 0.1)
    np.testing.assert_allclose(found, expected, atol=1e-6)


def test_result_does_not_depend_on_the_start():
    _, _, hessian, gradient = problem()
    options = {
        "l1": jnp.linspace(0.0, 8.0, 12),
        "lower": jnp.full(12, -0.2),
        "upper": jnp.full(12, 0.2),
        "sweeps": 1000,
    }
    first = shooting(hessian, gradient, start=jnp.zeros(12), **options)
    second = shooting(hessian, gradient, start=jnp.linspace(-0.2, 0.2, 12), **options)
    np.testing.assert_allclose(first, second, atol=1e-6)


def test_coordinate_without_curvature_keeps_its_start():
    found = shooting(
        jnp.diag(jnp.array([1.0, 0.0])), jnp.zeros(2), 1.0, jnp.full(2, -1.0), jnp.full(2, 1.0), jnp.array([0.5, 0.3])
    )
    np.testing.assert_allclose(found, [0.0, 0.3])


def test_mapping_over_the_l1_weight_equals_a_loop():
    _, _, hessian, gradient = problem()
    wide, weights = jnp.full(12, 1.0), jnp.array([0.0, 3.0, 50.0])
    solve = lambda l1: shooting(hessian, gradient, l1, -wide, wide, jnp.zeros(12))  # noqa: E731
    np.testing.assert_allclose(jax.vmap(solve)(weights), jnp.stack([solve(l1) for l1 in weights]), atol=1e-12)


def test_leaps_find_the_same_minimum_in_a_few_sweeps_where_coordinates_depend_on_each_other():
    rng = np.random.default_rng(4)
    matrix = rng.normal(size=(60, 39)) @ np.diag(10.0 ** rng.uniform(-2, 1, 39)) @ rng.normal(size=(39, 39))
    hessian, gradient = jnp.asarray(matrix.T @ matrix), jnp.asarray(matrix.T @ rng.normal(size=60))
    l1, upper = jnp.where(jnp.arange(39) < 30, 40.0, 0.0), jnp.full(39, 0.05)
    options = {"l1": l1, "lower": -upper, "upper": upper, "start": jnp.zeros(39), "tolerance": 1e-14}
    found = shooting(hessian, gradient, sweeps=40, **options)
    expected = shooting(hessian, gradient, sweeps=200_000, leaps=False, **options)
    assert jnp.any(expected == 0)
    assert jnp.any(jnp.abs(expected) == 0.05)
    assert jnp.sum((expected != 0) & (jnp.abs(expected) < 0.05)) > 3
    np.testing.assert_allclose(found, expected, atol=1e-7)
    slow = shooting(hessian, gradient, sweeps=40, leaps=False, **options)
    assert jnp.abs(slow - expected).max() > 1e-3
