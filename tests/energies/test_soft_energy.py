"""Eq. 5 on the soft rasteriser: it tends to the energy of the search, and its gradient is that of its differences."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scoring import FRAME, score

from jaxmocap.character import difference, retract
from jaxmocap.energies import ModelView, Posture, SearchEnergy, Silhouette, ViewView, search_energy, soft_score
from jaxmocap.render import SoftSettings

SETTINGS = SoftSettings(windows=4096, pixels=16384, shares=40960)
ALL = SearchEnergy(
    (
        ModelView(),
        ViewView(),
        ViewView(step=2, sampling="nearest"),
        ViewView(fail="ignore", outside="ignore"),
        Posture(),
    )
)
NAMES = ("model_view", "view_view", "coarse", "colour", "posture")
UNIT = np.where(np.arange(39) < 3, 0.3, 1.0)  # a tenth of a metre moves a limb as far as a third of a radian


@pytest.fixture(scope="module")
def off(world):
    """A pose some degrees away from the truth, where every degree of freedom has a slope."""
    away = np.random.default_rng(0).normal(0, 0.03, 39).astype(np.float32)
    return retract(world.character.skeleton, world.pose(FRAME), jnp.asarray(away))


@eqx.filter_jit
def _score(energy, character, pose, problem, settings):
    return soft_score(energy, character, pose, problem, settings)


def cosine(a, b):
    return float(a @ b / np.linalg.norm(a) / np.linalg.norm(b))


def test_it_tends_to_the_energy_of_the_search_as_the_width_goes_to_zero(world, off):
    increment = difference(world.character.skeleton, world.pose(FRAME), off)
    hard = score(world, np.asarray(increment)[None])
    hard = np.array([hard[name][0] for name in NAMES])
    gaps = []
    for width in (1.0, 0.25, 0.01):
        found = _score(ALL, world.character, off, world.problem(FRAME), SoftSettings(width, 12, 4096, 16384, 40960))
        assert np.all(np.asarray(found.needed) <= (4096, 16384, 40960))
        gaps.append(np.abs(np.asarray(found.terms) - hard))
    assert np.all(gaps[2] < (1e-4, 1e-3, 1e-3, 1e-3, 1e-5))
    assert np.all(gaps[0] < (0.01, 0.05, 0.05, 0.01, 1e-5))
    assert gaps[2].sum() < gaps[1].sum() < gaps[0].sum()


@pytest.fixture(scope="module")
def slopes(world, off):
    """Gradient of Eq. 5 in the pose, and its central differences."""
    skeleton, problem = world.character.skeleton, world.problem(FRAME)

    @jax.jit
    def value(delta):
        return soft_score(search_energy(), world.character, retract(skeleton, off, delta), problem, SETTINGS).total

    gradient = np.asarray(jax.jit(jax.grad(value))(jnp.zeros(39)))
    quotient = np.zeros(39)
    for dof in range(39):
        step = np.zeros(39, np.float32)
        step[dof] = 0.002 * UNIT[dof]
        quotient[dof] = (float(value(jnp.asarray(step))) - float(value(jnp.asarray(-step)))) / (2 * step[dof])
    return gradient * UNIT, quotient * UNIT


def test_the_gradient_in_the_pose_is_that_of_central_differences(slopes):
    gradient, quotient = slopes
    assert np.all(np.isfinite(gradient))
    assert cosine(gradient, quotient) > 0.99


def test_so_it_is_for_every_limb_alone(world, slopes):
    gradient, quotient = slopes
    for name, dofs in world.character.skeleton.groups:
        assert cosine(gradient[list(dofs)], quotient[list(dofs)]) > 0.97, name


def test_the_gradient_in_the_cameras_is_that_of_central_differences(world, off):
    problem = world.problem(FRAME)

    def moved(steps):
        """Translation, rotation and focal length of both cameras."""

        def one(pose, step):
            turn = jnp.array([[0, -step[5], step[4]], [step[5], 0, -step[3]], [-step[4], step[3], 0]])
            move = jnp.eye(4).at[:3, :3].add(turn + turn @ turn / 2).at[:3, 3].set(step[:3])
            return move @ pose

        focal = jnp.zeros((2, 3, 3)).at[:, 0, 0].set(500 * steps[:, 6]).at[:, 1, 1].set(500 * steps[:, 6])
        return eqx.tree_at(
            lambda p: (p.cam_from_world, p.intrinsics),
            problem,
            (jax.vmap(one)(problem.cam_from_world, steps), problem.intrinsics + focal),
        )

    @jax.jit
    def value(steps):
        return soft_score(search_energy(), world.character, off, moved(steps), SETTINGS).total

    gradient = np.asarray(jax.jit(jax.grad(value))(jnp.zeros((2, 7)))).reshape(-1)
    quotient = []
    for index in range(14):
        step = jnp.zeros(14).at[index].set(5e-4).reshape(2, 7)
        quotient.append((float(value(step)) - float(value(-step))) / 1e-3)
    assert np.all(np.isfinite(gradient))
    assert cosine(gradient, np.array(quotient)) > 0.99


def test_it_is_differentiable_in_lambda_and_in_the_colours_too(world, off):
    problem = world.problem(FRAME)

    @jax.jit
    def value(weight, table):
        energy = search_energy().reweight(view_view=weight)
        known = replace(problem.surface, colour_distance=table)
        return soft_score(energy, world.character, off, replace(problem, surface=known), SETTINGS).total

    table = problem.surface.colour_distance.astype(jnp.float32)
    direction = jnp.asarray(np.random.default_rng(0).uniform(0, 1, table.shape), jnp.float32) * 1e-2
    lambda_slope, slope = jax.jit(jax.grad(value, (0, 1)))(0.3, table)
    assert float(lambda_slope) == pytest.approx(float(value(0.8, table) - value(-0.2, table)), rel=1e-3)
    quotient = float(value(0.3, table + direction) - value(0.3, table - direction)) / 2
    assert np.all(np.isfinite(slope))
    assert float((slope * direction).sum()) == pytest.approx(quotient, rel=0.02)


def test_it_maps_over_poses(world, off):
    problem, skeleton = world.problem(FRAME), world.character.skeleton

    def value(delta):
        return soft_score(search_energy(), world.character, retract(skeleton, off, delta), problem, SETTINGS).total

    deltas = jnp.asarray(np.random.default_rng(2).normal(0, 0.02, (2, 39)), jnp.float32)
    values, slopes = jax.jit(jax.vmap(jax.value_and_grad(value)))(deltas)
    assert np.all(np.isfinite(slopes))
    for index in range(2):
        alone, slope = jax.jit(jax.value_and_grad(value))(deltas[index])
        assert float(values[index]) == pytest.approx(float(alone), rel=1e-4)
        assert cosine(np.asarray(slopes[index]), np.asarray(slope)) > 0.999


def test_a_person_out_of_sight_has_finite_energy_and_gradient(world, off):
    problem, skeleton = world.problem(FRAME), world.character.skeleton

    def value(shift):
        pose = retract(skeleton, off, jnp.zeros(39).at[0].set(shift))
        return soft_score(search_energy(), world.character, pose, problem, SETTINGS).total

    for shift in (30.0, -30.0):
        found, slope = jax.jit(jax.value_and_grad(value))(jnp.asarray(shift))
        assert np.isfinite(found)
        assert np.isfinite(slope)


def test_a_term_that_only_knows_key_buffers_is_refused(world, off):
    energy = SearchEnergy((Silhouette(jnp.asarray(world.masks(FRAME), jnp.float32)),))
    with pytest.raises(ValueError, match="'silhouette' has no soft form"):
        soft_score(energy, world.character, off, world.problem(FRAME))
