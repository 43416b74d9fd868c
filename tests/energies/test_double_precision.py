"""With `jax_enable_x64` the energies work, and say the same: kinematics and cameras are double, rasterisers single."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scoring import FRAME

from jaxmocap.character import retract
from jaxmocap.energies import (
    GroupProblem,
    Keypoints,
    SearchEnergy,
    body_part,
    prepare_base,
    score_particles,
    search_energy,
    soft_score,
)
from jaxmocap.render import SoftSettings

ENERGY = SearchEnergy((*search_energy(posture=0.005).terms, Keypoints()))
SETTINGS = SoftSettings(1.0, 12, 3072, 10240, 28672)
MOVES = np.random.default_rng(0).normal(0, 0.05, (3, 39))


def scores(world, moves, driver):
    """Of an arm; the last particle only fills up the shape."""
    character = world.character
    part = body_part(character, character.skeleton.group("l_arm"))
    group = GroupProblem(character, part, world.pose(FRAME), world.problem(FRAME))

    @eqx.filter_jit
    def total(energy, group, moves):
        base = prepare_base(energy, group, 4096)
        return score_particles(energy, group, base, moves, 4096, driver, jnp.array([True, True, False])).total

    return total(ENERGY, group, moves)


@pytest.mark.slow
@pytest.mark.parametrize("driver", ["loop", "scatter"])
def test_particles_score_the_same_in_double_precision(world, driver):
    single = scores(world, jnp.asarray(MOVES, jnp.float32), driver)
    with jax.enable_x64(True):
        double = scores(world, jnp.asarray(MOVES), driver)
        assert double.dtype == jnp.float64
        np.testing.assert_allclose(double, single, atol=2e-4)


@pytest.mark.slow
def test_the_soft_energy_and_its_gradient_are_the_same_in_double_precision(world):
    character, pose, problem = world.character, world.pose(FRAME), world.problem(FRAME)

    def value(move):
        return soft_score(ENERGY, character, retract(character.skeleton, pose, move), problem, SETTINGS).total

    single, slope = jax.jit(jax.value_and_grad(value))(jnp.asarray(MOVES[0], jnp.float32))
    with jax.enable_x64(True):
        double, steep = jax.jit(jax.value_and_grad(value))(jnp.asarray(MOVES[0]))
    assert float(double) == pytest.approx(float(single), abs=2e-4)
    np.testing.assert_allclose(steep, slope, atol=0.01 * np.abs(slope).max())
