"""One contract for every sampler: a new one joins by a line in `SAMPLERS`."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmocap._results import InputError
from jaxmocap._types import knob
from jaxmocap.samplers import (
    CrossEntropy,
    InteractingSimulatedAnnealing,
    Pool,
    RandomSearch,
    particles_for,
    run,
)

DOFS, PARTICLES, ITERATIONS = 4, 40, 8
SIZES = {"num_particles": PARTICLES, "num_iterations": ITERATIONS}
ISA = InteractingSimulatedAnnealing
SAMPLERS = {
    "isa": ISA(**SIZES),
    "isa polynomial": ISA(**SIZES, schedule="poly_std", strict=True, resampling="systematic"),
    "isa literal": ISA(**SIZES, schedule="poly_raw", epsilon="zero", answer="mean"),
    "cross entropy": CrossEntropy(**SIZES, elites=0.2),
    "random search": RandomSearch(**SIZES),
}
TARGET = jnp.array([0.2, -0.1, 0.15, -0.25])
START, SPREAD, LOWER, UPPER = jnp.zeros(DOFS), jnp.full(DOFS, 0.3), jnp.full(DOFS, -0.5), jnp.full(DOFS, 0.4)


class Bowl(eqx.Module):
    """Squared distance to the target, not a number below `hole` along the first axis. One class: compiled once."""

    target: jax.Array
    scale: jax.Array = knob(1.0)
    hole: jax.Array = knob(-jnp.inf)

    def __call__(self, particles):
        energies = self.scale * jnp.sum((particles - self.target) ** 2, axis=-1)
        return jnp.where(particles[:, 0] < self.hole, jnp.nan, energies)


def searched(sampler, energy=Bowl(TARGET), key=0, **options):
    return run(sampler, energy, START, SPREAD, LOWER, UPPER, jax.random.key(key), **options)


UNSCORED = [pytest.mark.nans]
"""An answer that is never evaluated has an energy of NaN."""


@pytest.fixture(
    params=[pytest.param(s, marks=UNSCORED if s.answer == "mean" else []) for s in SAMPLERS.values()],
    ids=SAMPLERS.keys(),
)
def sampler(request):
    return request.param


def test_ask_and_tell_keep_shapes_types_and_limits(sampler):
    state = sampler.init(jax.random.key(0), START, SPREAD, LOWER, UPPER)
    for iteration in range(3):
        particles = sampler.ask(state, jax.random.key(iteration))
        assert particles.shape == (PARTICLES, DOFS)
        assert np.all((particles >= LOWER) & (particles <= UPPER))
        new_state, info = sampler.tell(state, particles, Bowl(TARGET)(particles), jax.random.key(10 + iteration))
        assert jax.tree.structure(new_state) == jax.tree.structure(state)
        assert [x.dtype for x in jax.tree.leaves(new_state)] == [x.dtype for x in jax.tree.leaves(state)]
        np.testing.assert_allclose(info.best_energy, Bowl(TARGET)(particles).min(), rtol=1e-5)
        state = new_state
    mean, deviation = sampler.result(state)
    assert mean.shape == deviation.shape == (DOFS,)


def test_first_particles_are_the_start_and_the_warm_population(sampler):
    population = jnp.array([[0.1, 0.2, 0.3, 0.4], [-0.1, -0.2, -0.3, -0.4]])
    state = sampler.init(jax.random.key(0), START, SPREAD, LOWER, UPPER, population)
    particles = sampler.ask(state, jax.random.key(1))
    np.testing.assert_array_equal(particles[:3], jnp.concatenate([START[None], population]))


def test_same_key_gives_the_same_bits_and_another_key_does_not(sampler):
    first, again, other = searched(sampler)[0], searched(sampler)[0], searched(sampler, key=1)[0]
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)


def test_search_comes_closer_than_the_start(sampler):
    found, info = searched(sampler, Bowl(TARGET, scale=50.0))  # the literal schedule needs a scaled energy
    assert jnp.linalg.norm(found - TARGET) < 0.5 * jnp.linalg.norm(TARGET)
    rows = ITERATIONS if sampler.answer == "mean" else ITERATIONS + 1
    assert info.steps.beta.shape == (rows,)
    assert info.steps.spread.shape == (rows, DOFS)
    assert info.best_energy == jnp.min(info.steps.best_energy)


def test_best_if_better_returns_the_lower_of_the_mean_and_the_best(sampler):
    found, info = searched(sampler)
    if sampler.answer == "mean":
        np.testing.assert_array_equal(found, info.mean)
        assert jnp.isnan(info.energy)
    else:
        np.testing.assert_allclose(info.mean_energy, Bowl(TARGET)(info.mean[None])[0], rtol=1e-4, atol=1e-9)
        np.testing.assert_allclose(info.energy, Bowl(TARGET)(found[None])[0], rtol=1e-4, atol=1e-9)
        assert info.energy <= info.mean_energy


def test_energies_that_are_not_numbers_count_as_infinite(sampler):
    found, info = searched(sampler, Bowl(TARGET, hole=0.05))
    assert found[0] >= 0.05
    assert jnp.all(jnp.isfinite(found))
    assert jnp.all(jnp.isfinite(info.best))


def test_nothing_finite_leaves_the_best_at_the_start(sampler):
    found, info = searched(sampler, Bowl(TARGET, hole=jnp.inf))
    np.testing.assert_array_equal(info.best, START)
    assert jnp.isinf(info.best_energy)
    assert jnp.all(jnp.isfinite(found))


def test_constant_energy_neither_explodes_nor_leaves_the_start(sampler):
    unlimited = jnp.full(DOFS, jnp.inf)
    found, info = run(sampler, Bowl(TARGET, scale=0.0), START, SPREAD, -unlimited, unlimited, jax.random.key(0))
    assert jnp.max(info.steps.spread) < 3 * SPREAD[0]
    np.testing.assert_array_equal(info.best, START)
    assert jnp.all(jnp.abs(found) < 2 * SPREAD)


def test_dimension_without_spread_stays_exactly_where_it_is(sampler):
    start = START.at[2].set(0.123)
    found, _ = run(sampler, Bowl(TARGET), start, SPREAD.at[2].set(0.0), LOWER, UPPER, jax.random.key(0))
    np.testing.assert_allclose(found[2], 0.123, atol=1e-7)
    assert abs(found[0] - TARGET[0]) < 0.15


def test_an_energy_on_the_host_is_searched_like_a_compiled_one(sampler):
    def on_host(particles):
        return np.sum((np.asarray(particles) - np.asarray(TARGET)) ** 2, axis=-1, dtype=np.float32)

    shape = jax.ShapeDtypeStruct((PARTICLES,), jnp.float32)
    found, _ = searched(sampler, lambda particles: jax.pure_callback(on_host, shape, particles))
    np.testing.assert_allclose(found, searched(sampler)[0], atol=1e-4)


def test_the_best_of_a_pool_begin_beside_the_start(sampler):
    """Numbers of candidates that do not fill whole sets."""
    pool = jax.random.uniform(jax.random.key(5), (2 * PARTICLES + 7, DOFS), minval=LOWER, maxval=UPPER)
    pool = pool.at[-1].set(TARGET + 0.01)  # the one that a set is filled up with
    best, given = pool[jnp.argsort(Bowl(TARGET)(pool))[:5]], START[None] + 0.05
    expected, plain = searched(sampler, population=jnp.concatenate([given, best]))
    found, info = searched(sampler, population=given, pool=Pool(pool, 5))
    np.testing.assert_allclose(found, expected, atol=1e-4)
    assert jax.tree.map(jnp.shape, info) == jax.tree.map(jnp.shape, plain)


def test_mapping_over_keys_and_starts_equals_a_loop(sampler):
    keys, starts = jax.random.split(jax.random.key(3), 2), jnp.stack([START, START + 0.1])
    mapped, _ = jax.vmap(lambda key, start: run(sampler, Bowl(TARGET), start, SPREAD, LOWER, UPPER, key))(keys, starts)
    for key, start, found in zip(keys, starts, mapped, strict=True):
        alone, _ = run(sampler, Bowl(TARGET), start, SPREAD, LOWER, UPPER, key)
        np.testing.assert_allclose(alone, found, atol=2e-3)


def test_other_numbers_and_other_data_do_not_compile_again(sampler):
    traces = []

    class Counting(eqx.Module):
        target: jax.Array

        def __call__(self, particles):
            traces.append(particles.shape)
            return Bowl(self.target)(particles)

    searched(sampler, Counting(TARGET))
    seen = len(traces)
    halved = jax.tree.map(lambda leaf: 0.5 * leaf, sampler)
    searched(halved, Counting(TARGET + 0.1), key=5)
    assert len(traces) == seen


def test_energy_may_close_over_values_of_an_outer_compilation():
    compiled = jax.jit(lambda target: searched(SAMPLERS["isa"], lambda particles: Bowl(target)(particles))[0])
    np.testing.assert_allclose(compiled(TARGET), searched(SAMPLERS["isa"])[0], atol=1e-4)


def test_sampler_maps_over_a_swept_number():
    spreads = eqx.filter_vmap(
        lambda alpha: searched(eqx.tree_at(lambda s: s.alpha, SAMPLERS["isa"], alpha))[1].steps.spread[-1]
    )(jnp.array([0.1, 0.8]))
    assert jnp.all(spreads[1] > spreads[0])


def test_particle_count_of_the_paper():
    assert (particles_for(6), particles_for(7)) == (104, 168)


def test_warm_start_larger_than_the_set_is_refused():
    with pytest.raises(InputError, match="warm start has 40 particles"):
        searched(SAMPLERS["isa"], population=jnp.zeros((40, DOFS)))
