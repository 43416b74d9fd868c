"""Searches in one call against the same searches one by one."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmocap._results import InputError
from jaxmocap.character import retract
from jaxmocap.energies import search_energy
from jaxmocap.experiments import SearchBatch
from jaxmocap.samplers import InteractingSimulatedAnnealing

WEIGHT = "terms.view_view.weight"


@pytest.fixture(scope="module")
def batch(world) -> SearchBatch:
    """The left arm, 8 degrees off."""
    moved = jnp.zeros(39).at[world.character.skeleton.dof_names.index("l_shoulder_abd")].set(np.radians(8.0))
    pose = retract(world.character.skeleton, world.pose(2), moved)
    sampler = InteractingSimulatedAnnealing(num_particles=16, num_iterations=4)
    energy = search_energy(uncovered_scale=4.0, step=2, sampling="nearest")
    return SearchBatch.make(energy, sampler, world.character, pose, world.problem(2), "l_arm", step=4)


@pytest.mark.slow
@pytest.mark.parametrize("driver", ["loop", pytest.param("scatter", marks=pytest.mark.slow)])
def test_one_call_finds_what_a_loop_finds(batch, driver):
    batch = replace(batch, driver=driver)
    weights, seeds = jnp.array([0.0, 0.5]), jnp.array([0, 7])
    found = batch({WEIGHT: weights}, seeds)
    assert found.increments.shape == (2, 2, 39)
    for i, weight in enumerate(weights):
        energy = batch.energy.reweight(view_view=weight)
        for j, seed in enumerate(seeds):
            increment, value = batch.one(energy, jax.random.key(seed))
            np.testing.assert_allclose(found.increments[i, j], increment, atol=1e-5)
            assert float(found.energies[i, j]) == pytest.approx(float(value), rel=1e-5)
    assert not np.allclose(found.increments[0], found.increments[1])
    moves = np.flatnonzero(np.abs(np.asarray(found.increments)).max((0, 1)))
    assert set(moves) <= set(batch.dofs)


def test_settings_are_leaves_of_the_energy_of_one_length(batch):
    energies, axes = batch.batched({WEIGHT: jnp.zeros(3), "terms.model_view.epsilon": jnp.ones(3)})
    assert sum(axis == 0 for axis in jax.tree.leaves(axes)) == 2
    assert eqx.tree_equal(energies.terms[0].weight, batch.energy.terms[0].weight)
    with pytest.raises(InputError, match="one length"):
        batch.batched({WEIGHT: jnp.zeros(3), "terms.model_view.epsilon": jnp.ones(2)})
    with pytest.raises(InputError, match="there is no 'weigth'"):
        batch.batched({"terms.view_view.weigth": jnp.zeros(3)})
    with pytest.raises(InputError, match=r"seeds has the shape \(\); \(seed,\) was expected: whole numbers"):
        batch({WEIGHT: jnp.zeros(3)}, jax.random.key(0))
