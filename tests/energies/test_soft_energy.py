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
from jaxmocap.geometry import matmul
from jaxmocap.render import SoftSettings

BOUNDS = (3072, 10240, 28672)
SETTINGS = SoftSettings(1.0, 12, *BOUNDS)
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


@pytest.mark.slow
def test_it_tends_to_the_energy_of_the_search_as_the_width_goes_to_zero(world, off):
    increment = difference(world.character.skeleton, world.pose(FRAME), off)
    hard = score(world, np.asarray(increment)[None])
    hard = np.array([hard[name][0] for name in NAMES])
    gaps = []
    for width in (1.0, 0.25, 0.01):
        found = _score(ALL, world.character, off, world.problem(FRAME), SoftSettings(width, 12, *BOUNDS))
        assert np.all(np.asarray(found.needed) <= BOUNDS)
        gaps.append(np.abs(np.asarray(found.terms) - hard))
    assert np.all(gaps[2] < (1e-4, 1e-3, 1e-3, 1e-3, 1e-5))
    assert np.all(gaps[0] < (0.01, 0.05, 0.05, 0.01, 1e-5))
    assert gaps[2].sum() < gaps[1].sum() < gaps[0].sum()


def _moved_cameras(problem, steps):
    """Both cameras moved by translation, rotation and focal length: steps (2, 7), focal lengths in units of 500."""

    def one(pose, step):
        turn = jnp.array([[0, -step[5], step[4]], [step[5], 0, -step[3]], [-step[4], step[3], 0]])
        return matmul(jnp.eye(4).at[:3, :3].add(turn + matmul(turn, turn) / 2).at[:3, 3].set(step[:3]), pose)

    focal = jnp.zeros((2, 3, 3)).at[:, 0, 0].set(500 * steps[:, 6]).at[:, 1, 1].set(500 * steps[:, 6])
    return replace(
        problem,
        cam_from_world=jax.vmap(one)(problem.cam_from_world, steps),
        intrinsics=problem.intrinsics + focal,
    )


@pytest.fixture(scope="module")
def eq5(world, off):
    """Eq. 5 of an increment of the pose, of the cameras, of lambda and of the table of colours; and its gradient."""
    problem, skeleton = world.problem(FRAME), world.character.skeleton

    def value(delta, cameras, weight, table):
        energy = search_energy().reweight(view_view=weight)
        seen = replace(_moved_cameras(problem, cameras), surface=replace(problem.surface, colour_distance=table))
        return soft_score(energy, world.character, retract(skeleton, off, delta), seen, SETTINGS).total

    at = (jnp.zeros(39), jnp.zeros((2, 7)), jnp.asarray(0.3), problem.surface.colour_distance.astype(jnp.float32))
    return value, jax.jit(value), jax.jit(jax.value_and_grad(value, (0, 1, 2, 3))), at


@pytest.fixture(scope="module")
def gradient(eq5):
    _, _, slope, at = eq5
    return slope(*at)[1]


def cosine(a, b):
    return float(a @ b / np.linalg.norm(a) / np.linalg.norm(b))


@pytest.fixture(scope="module")
def in_pose(eq5, gradient):
    """Gradient in the pose, and central differences."""
    _, value, _, at = eq5
    quotient = np.zeros(39)
    for dof in range(39):
        step = jnp.zeros(39).at[dof].set(0.002 * UNIT[dof])
        quotient[dof] = (float(value(step, *at[1:])) - float(value(-step, *at[1:]))) / (0.004 * UNIT[dof])
    return np.asarray(gradient[0]) * UNIT, quotient * UNIT


@pytest.mark.slow
def test_the_gradient_in_the_pose_is_that_of_central_differences(in_pose):
    assert np.all(np.isfinite(in_pose[0]))
    assert cosine(*in_pose) > 0.99


@pytest.mark.slow
def test_so_it_is_for_every_limb_alone(world, in_pose):
    for name, dofs in world.character.skeleton.groups:
        assert cosine(*(side[list(dofs)] for side in in_pose)) > 0.97, name


@pytest.mark.slow
def test_the_gradient_in_the_cameras_is_that_of_central_differences(eq5, gradient):
    _, value, _, at = eq5
    quotient = []
    for index in range(14):
        step = jnp.zeros(14).at[index].set(5e-4).reshape(2, 7)
        quotient.append((float(value(at[0], step, *at[2:])) - float(value(at[0], -step, *at[2:]))) / 1e-3)
    slope = np.asarray(gradient[1]).reshape(-1)
    assert np.all(np.isfinite(slope))
    assert cosine(slope, np.array(quotient)) > 0.99
    assert np.linalg.norm(slope) == pytest.approx(np.linalg.norm(quotient), rel=0.1)


def test_the_gradients_in_lambda_and_in_the_colours_are_those_of_differences(eq5, gradient):
    _, value, _, (pose, cameras, weight, table) = eq5
    rise = float(value(pose, cameras, weight + 0.5, table) - value(pose, cameras, weight - 0.5, table))
    assert float(gradient[2]) == pytest.approx(rise, rel=1e-3)
    way = jnp.asarray(np.random.default_rng(0).uniform(0, 1e-2, table.shape), jnp.float32)
    rise = float(value(pose, cameras, weight, table + way) - value(pose, cameras, weight, table - way)) / 2
    assert np.all(np.isfinite(gradient[3]))
    assert float((gradient[3] * way).sum()) == pytest.approx(rise, rel=0.02)


def test_a_person_out_of_sight_has_finite_energy_and_gradient(eq5):
    _, _, slope, at = eq5
    for shift in (30.0, -30.0):
        found = slope(at[0].at[0].set(shift), *at[1:])
        assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(found))


@pytest.mark.slow
def test_it_maps_over_poses(eq5):
    value, _, slope, at = eq5
    deltas = jnp.asarray(np.random.default_rng(2).normal(0, 0.02, (2, 39)), jnp.float32)
    values, slopes = jax.jit(jax.vmap(jax.value_and_grad(value), (0, None, None, None)))(deltas, *at[1:])
    for index in range(2):
        alone, by_alone = slope(deltas[index], *at[1:])
        assert float(values[index]) == pytest.approx(float(alone), rel=1e-4)
        assert cosine(np.asarray(slopes[index]), np.asarray(by_alone[0])) > 0.999


def test_a_term_that_only_knows_key_buffers_is_refused(world, off):
    energy = SearchEnergy((Silhouette(jnp.asarray(world.masks(FRAME), jnp.float32)),))
    with pytest.raises(ValueError, match="'silhouette' has no soft form"):
        soft_score(energy, world.character, off, world.problem(FRAME))
