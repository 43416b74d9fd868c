"""Interacting simulated annealing against known answers, and its parts."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmocap._results import InputError
from jaxmocap.samplers import (
    InteractingSimulatedAnnealing,
    effective_sample_size,
    multinomial,
    reflect,
    run,
    systematic,
)
from jaxmocap.samplers._annealing import beta_for_effective_sample_size, boltzmann_weights, energy_gaps

TARGET = jnp.array([0.3, -0.2, 0.1, 0.25, -0.3, 0.15, 0.2])
ZERO = jnp.zeros(7)


def bowl(particles):
    return jnp.sum((particles - TARGET) ** 2, axis=-1)


def pixel_average(particles):
    """An energy like Eq. 5 on a limb: a ten degree move changes it by about 0.01."""
    return 0.3 + 0.05 * bowl(particles)


@pytest.mark.parametrize("answer", [pytest.param("mean", marks=pytest.mark.nans), "best_if_better"])
def test_seven_dimensional_bowl_is_solved_to_one_percent_of_the_start_error(answer):
    sampler = InteractingSimulatedAnnealing(num_particles=168, num_iterations=25, answer=answer)
    for seed in range(3):
        found, _ = run(sampler, bowl, ZERO, ZERO + 0.2, ZERO - 1.5, ZERO + 1.5, jax.random.key(seed))
        assert jnp.linalg.norm(found - TARGET) < 0.01 * jnp.linalg.norm(TARGET)


@pytest.mark.nans
def test_raw_polynomial_schedule_selects_nothing_on_pixel_averages():
    raw = InteractingSimulatedAnnealing(schedule="poly_raw", answer="mean")
    _, info = run(raw, pixel_average, ZERO, ZERO + 0.2, ZERO - 3, ZERO + 3, jax.random.key(0))
    assert info.steps.effective_sample_size[0] > 167
    assert jnp.all(info.steps.spread[-1] > 2 * info.steps.spread[0])
    np.testing.assert_allclose(info.steps.beta, jnp.arange(1, 26) ** 0.7, rtol=1e-5)


@pytest.mark.nans
def test_scaled_polynomial_schedule_selects_on_the_same_energy():
    scaled = InteractingSimulatedAnnealing(schedule="poly_std", answer="mean")
    found, info = run(scaled, pixel_average, ZERO, ZERO + 0.2, ZERO - 3, ZERO + 3, jax.random.key(0))
    assert jnp.all(info.steps.spread[-1] < info.steps.spread[0])
    assert jnp.linalg.norm(found - TARGET) < 0.25 * jnp.linalg.norm(TARGET)


def test_effective_sample_size_is_held_at_the_survival_share():
    _, info = run(
        InteractingSimulatedAnnealing(survival=0.5), bowl, ZERO, ZERO + 0.2, ZERO - 1, ZERO + 1, jax.random.key(0)
    )
    np.testing.assert_allclose(info.steps.effective_sample_size, 0.5 * 168, rtol=1e-3)


def test_strict_annealing_never_lowers_beta():
    _, info = run(
        InteractingSimulatedAnnealing(strict=True), bowl, ZERO, ZERO + 0.2, ZERO - 1, ZERO + 1, jax.random.key(0)
    )
    assert jnp.all(jnp.diff(info.steps.beta) >= 0)


def test_noise_floor_is_taken_per_dimension():
    floor = jnp.array([0.1, 0.1, 0.1, 0.001, 0.001, 0.001, 0.001])
    _, info = run(
        InteractingSimulatedAnnealing(sigma_min=floor), bowl, ZERO, ZERO + 0.2, ZERO - 1, ZERO + 1, jax.random.key(0)
    )
    assert jnp.all(info.steps.spread[-1][:3] > 0.08)
    assert jnp.all(info.steps.spread[-1][3:] < 0.06)


@pytest.mark.parametrize("epsilon", ["inverse_max", "zero"])
def test_selection_keeps_the_share_of_each_particle_in_proportion_to_its_weight(epsilon):
    sampler = InteractingSimulatedAnnealing(
        num_particles=4000, schedule="poly_raw", epsilon=epsilon, alpha=0.0, sigma_min=0.0
    )
    state = sampler.init(jax.random.key(0), jnp.zeros(1), jnp.ones(1), -jnp.ones(1), jnp.ones(1))
    particles = jnp.where(jnp.arange(4000) < 2000, -0.5, 0.5)[:, None]
    energies = jnp.where(particles[:, 0] < 0, 0.0, jnp.log(3.0))  # weights 1 and 1/3 at beta 1
    after, _ = sampler.tell(state, particles, energies, jax.random.key(1))
    share = jnp.mean(after.proposal.centres[:, 0] < 0)
    # kept surely, or redrawn with probability 3/4: 1/2 + 1/2 * 2/3 * 3/4 = 3/4 either way
    np.testing.assert_allclose(share, 0.75, atol=0.02)


def test_beta_reaches_a_known_effective_sample_size():
    gaps = energy_gaps(jnp.array([2.0, 2.0, 2.5, jnp.nan]))
    beta = beta_for_effective_sample_size(gaps, jnp.asarray(0.6))
    weights = boltzmann_weights(gaps, beta)
    np.testing.assert_allclose(effective_sample_size(weights), 0.6 * 4, rtol=1e-4)
    assert weights[3] == 0
    assert weights[0] == 1


@pytest.mark.parametrize("resample", [multinomial, systematic])
def test_resampling_follows_the_weights_and_never_draws_a_zero(resample):
    weights = jnp.concatenate([jnp.zeros(100), jnp.ones(100), jnp.full(100, 3.0), jnp.zeros(100)])
    indices = jnp.stack([resample(jax.random.key(seed), weights, jnp.ones(400, bool)) for seed in range(5)])
    assert jnp.all((indices >= 100) & (indices < 300))
    np.testing.assert_allclose(jnp.mean(indices >= 200), 0.75, atol=0.03)


def test_systematic_resampling_is_exact_for_whole_shares_and_leaves_kept_particles():
    weights = jnp.array([1.0, 0.0, 3.0, 0.0, 9.0, 9.0, 9.0])
    redrawn = jnp.array([True, True, False, True, True, False, False])
    weights = jnp.where(jnp.arange(7) >= 4, 0.0, weights)
    indices = systematic(jax.random.key(0), weights, redrawn)
    np.testing.assert_array_equal(indices, [0, 2, 2, 2, 2, 5, 6])


def test_reflection_folds_like_a_mirror_on_every_kind_of_limit():
    lower = jnp.array([0.0, 0.0, -jnp.inf, -jnp.inf, 0.3])
    upper = jnp.array([1.0, jnp.inf, 1.0, jnp.inf, 0.3])
    np.testing.assert_allclose(
        reflect(
            jnp.array([[1.25, -2.0, 1.5, 9.0, 7.0], [-0.25, 2.0, -9.0, -9.0, -7.0], [3.75, 0.0, 1.0, 0.0, 0.3]]),
            lower,
            upper,
        ),
        [[0.75, 2.0, 0.5, 9.0, 0.3], [0.25, 2.0, -9.0, -9.0, 0.3], [0.25, 0.0, 1.0, 0.0, 0.3]],
        atol=1e-6,
    )


def test_reflection_returns_values_inside_the_limits_unchanged():
    inside = jnp.array([0.1, 0.333, 0.7])
    np.testing.assert_array_equal(reflect(inside, jnp.full(3, -0.2), jnp.full(3, 0.9)), inside)


def test_unknown_option_is_named_in_the_message():
    with pytest.raises(InputError, match="schedule is 'cosine'"):
        InteractingSimulatedAnnealing(schedule="cosine")
