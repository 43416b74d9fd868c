"""No random key is used twice in a search."""

import inspect

import jax
import jax.numpy as jnp
import pytest

from jaxmocap.energies import Posture, SearchEnergy
from jaxmocap.samplers import CrossEntropy, InteractingSimulatedAnnealing
from jaxmocap.search import Reach, group_searches


@pytest.fixture
def used(monkeypatch):
    """What was done with keys, as compiled programs run: (function, key, number folded in or None)."""
    seen = []

    def recording(name, function):
        def record(key, *args, **options):
            note = lambda bits, number: seen.append((name, bits.tobytes(), None if number < 0 else int(number)))  # noqa: E731
            jax.debug.callback(note, jax.random.key_data(key), jnp.asarray(args[0] if name == "fold_in" else -1, int))
            return function(key, *args, **options)

        return record

    for name, function in vars(jax.random).copy().items():
        takes_key = inspect.isfunction(function) and next(iter(inspect.signature(function).parameters), "") == "key"
        if takes_key and name not in ("clone", "key_data", "key_impl"):
            monkeypatch.setattr(jax.random, name, recording(name, function))
    return seen


@pytest.mark.parametrize("sampler", [InteractingSimulatedAnnealing, CrossEntropy])
def test_no_key_is_used_twice_in_the_search_of_a_limb_with_particles_further_afield(world, used, sampler):
    energy, spread = SearchEnergy((Posture(),)), world.character.skeleton.initial_spread
    search = next(group for group in group_searches(world.character, energy, step=4) if group.name == "l_arm")
    sized = sampler(num_particles=11, num_iterations=3)
    scene = (world.pose(2), world.problem(2), spread, jax.random.key(0))
    jax.block_until_ready(search(sized, *scene, Reach(wide=0.2)))
    jax.effects_barrier()
    consumed = [key for name, key, _ in used if name != "fold_in"]
    folded = [(key, number) for name, key, number in used if name == "fold_in"]
    assert {"normal", "uniform", "split"} <= {name for name, _, _ in used}
    assert len(set(consumed)) == len(consumed)
    assert len(set(folded)) == len(folded)
    assert not set(consumed) & {key for key, _ in folded}
