"""CMA-ES behind the samplers' interface."""

import jax
import jax.numpy as jnp
import pytest

from jaxmocap.baselines import CovarianceMatrixAdaptation
from jaxmocap.samplers import run

pytest.importorskip("evosax")


def test_it_finds_the_bottom_of_a_tilted_bowl_within_the_limits():
    target, axes = jnp.array([0.2, -0.1, 0.3]), jnp.array([1.0, 3.0, 10.0])
    sampler = CovarianceMatrixAdaptation(num_particles=24, num_iterations=40)
    bowl = lambda particles: jnp.sum((axes * (particles - target)) ** 2, axis=-1)  # noqa: E731
    limit = jnp.full(3, 0.5)
    found, info = run(sampler, bowl, jnp.zeros(3), 0.3 * limit, -limit, limit, jax.random.key(0))
    assert jnp.abs(found - target).max() < 2e-3
    assert info.best_energy < 1e-3


def test_the_answer_stays_within_the_limits_and_is_the_same_for_the_same_seed():
    sampler = CovarianceMatrixAdaptation(num_particles=16, num_iterations=20)
    slope = lambda particles: particles.sum(-1)  # noqa: E731
    limit = jnp.full(2, 0.1)
    answers = [run(sampler, slope, jnp.zeros(2), limit, -limit, limit, jax.random.key(1))[0] for _ in range(2)]
    assert jnp.array_equal(*answers)
    assert jnp.all(jnp.abs(answers[0]) <= limit + 1e-6)
    assert answers[0].sum() < -0.18
