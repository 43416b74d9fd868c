"""How far the trunk is bent, in shares of its limits."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scoring import FRAME, score

from jaxmocap.character import pose_vector, rest_pose, retract
from jaxmocap.energies import Posture, bend


@pytest.fixture(scope="module")
def skeleton(world):
    return world.character.skeleton


def value(world, angles) -> float:
    skeleton = world.character.skeleton
    pose = eqx.tree_at(lambda p: p.angles, rest_pose(skeleton), jnp.asarray(angles, jnp.float32))
    return float(Posture().score_pose(skeleton, pose, world.problem(FRAME)))


def test_the_rest_pose_is_free_and_every_limit_of_the_trunk_costs_one(world, skeleton):
    assert value(world, np.zeros(33)) == 0
    assert value(world, skeleton.upper) == pytest.approx(11)  # lumbar 3, thorax 1, neck 3, two collar bones with 2
    assert value(world, skeleton.lower) == pytest.approx(11)
    assert value(world, 0.5 * skeleton.lower) == pytest.approx(11 / 4)


def test_arms_and_legs_and_where_the_body_stands_cost_nothing(world, skeleton):
    limbs = [
        i for i, name in enumerate(skeleton.dof_names[6:]) if any(j in name for j in ("shoulder", "elbow", "knee"))
    ]
    assert len(limbs) == 10
    assert value(world, np.asarray(skeleton.upper) * np.isin(np.arange(33), limbs)) == 0
    moved = retract(skeleton, rest_pose(skeleton), jnp.zeros(39).at[:6].set(1.0))
    assert float(Posture().score_pose(skeleton, moved, world.problem(FRAME))) == 0


def test_the_derivative_is_that_of_finite_differences(world, skeleton):
    rng = np.random.default_rng(0)
    angles = jnp.asarray(rng.uniform(skeleton.lower, skeleton.upper), jnp.float32)
    slope = jax.grad(lambda a: jnp.sum(bend(skeleton, a) ** 2))(angles)
    for dof in range(33):
        step = np.zeros(33)
        step[dof] = 1e-2
        ahead, behind = (value(world, np.asarray(angles) + sign * step) for sign in (1, -1))
        np.testing.assert_allclose(slope[dof], (ahead - behind) / 2e-2, atol=5e-3, rtol=5e-3)


def test_particles_are_scored_by_the_posture_they_would_take(world, skeleton):
    increments = np.zeros((3, 39), np.float32)
    increments[1, skeleton.dof_names.index("lumbar_lat")] = 0.3
    increments[2, skeleton.dof_names.index("l_knee_flex")] = 0.3
    terms = score(world, increments)
    angles = np.asarray(pose_vector(skeleton, world.pose(FRAME)))[6:] + increments[:, 6:]
    limits = np.where(angles >= 0, skeleton.upper, -np.asarray(skeleton.lower))
    trunk = [any(part in name for part in ("lumbar", "thorax", "neck", "clav")) for name in skeleton.dof_names[6:]]
    np.testing.assert_allclose(terms["posture"], ((angles / limits)[:, trunk] ** 2).sum(1), rtol=1e-3, atol=1e-5)
    assert terms["posture"][1] > terms["posture"][0] + 0.1
    assert terms["posture"][2] == pytest.approx(terms["posture"][0], abs=1e-5)
