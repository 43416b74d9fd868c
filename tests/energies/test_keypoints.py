"""Landmarks against the rays of 2D keypoints, and the term that detections add to the search energy."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scoring import FRAME
from synthetic_world import MIDDLES, POINTS

from jaxmocap.character import retract
from jaxmocap.energies import Keypoints, keypoint_rays, search_energy

NUM_POINTS = len(POINTS) + len(MIDDLES)


def rays_of(world, keypoints, **options):
    view = world.cameras.at(FRAME)
    skeleton = world.character.skeleton
    return keypoint_rays(skeleton, view.intrinsics, view.cam_from_world, jnp.asarray(keypoints), **options)


def value(world, pose, keypoints, term=None, step=1) -> float:
    problem = eqx.tree_at(lambda p: p.keypoints, world.problem(FRAME), jnp.asarray(keypoints, jnp.float32))
    term = Keypoints() if term is None else term
    return float(term.score_pose(world.character.skeleton, pose, problem.coarser(step)))


def moved(world, dof, amount):
    skeleton = world.character.skeleton
    delta = jnp.zeros(39).at[skeleton.dof_names.index(dof)].set(amount)
    return retract(skeleton, world.pose(FRAME), delta)


def test_rays_of_the_truth_have_no_residual(world):
    lines = rays_of(world, world.keypoints(FRAME))
    assert int((lines.weight > 0).sum()) == 2 * NUM_POINTS
    np.testing.assert_allclose(np.asarray(lines.mix).sum(1), 1, atol=1e-6)
    residual = np.asarray(lines(world.character, world.pose(FRAME))) * 0.02  # in metres
    assert np.abs(residual).max() < 2e-4


def test_points_that_were_not_found_count_nothing(world):
    half = world.keypoints(FRAME)
    half[0][:10, 2] = half[1][:, 2] = 0
    lines = rays_of(world, half)
    assert int((lines.weight > 0).sum()) == sum(index >= 10 for index in POINTS.values())
    away = moved(world, "root_tx", 0.3)
    assert np.abs(lines(world.character, away)).max() > 0
    half[:, :, 2] = 0
    np.testing.assert_array_equal(rays_of(world, half)(world.character, away), 0)
    assert value(world, away, half) == 0


def test_the_term_is_least_at_the_truth_along_every_dof_that_points_see(world):
    names = ("root_tx", "root_ty", "root_rz", "l_shoulder_abd", "r_elbow_flex", "l_hip_flex", "r_knee_flex")
    keypoints = world.keypoints(FRAME)
    least = value(world, world.pose(FRAME), keypoints)
    assert least < 1e-6
    for name in names:
        sides = [value(world, moved(world, name, amount), keypoints) for amount in (-0.2, -0.1, 0.1, 0.2)]
        assert min(sides[1:3]) > 1e-5, name
        assert sides[0] > sides[1], name
        assert sides[3] > sides[2], name


def test_a_gross_error_costs_no_more_than_its_point(world):
    keypoints = world.keypoints(FRAME)
    wrong = keypoints.copy()
    wrong[0, POINTS["l_wrist"], :2] += 4000.0
    rows = rays_of(world, keypoints).weight.shape[0]
    found = value(world, world.pose(FRAME), wrong)
    assert 0.9 / rows > found > 0.5 / rows  # four points of the face are among the rows of the term
    doubted = wrong.copy()
    doubted[0, POINTS["l_wrist"], 2] = 0.1
    assert value(world, world.pose(FRAME), doubted) == pytest.approx(0.1 * found, rel=1e-3)


def test_a_coarser_problem_sees_the_same_rays(world):
    keypoints, pose = world.keypoints(FRAME), moved(world, "l_shoulder_abd", 0.3)
    fine = value(world, pose, keypoints)
    assert value(world, pose, keypoints, step=4) == pytest.approx(fine, rel=1e-3)


def test_the_gradient_is_that_of_finite_differences(world):
    problem = eqx.tree_at(lambda p: p.keypoints, world.problem(FRAME), jnp.asarray(world.keypoints(FRAME)))
    start, skeleton = moved(world, "l_shoulder_abd", 0.2), world.character.skeleton

    def energy(delta):
        return Keypoints().score_pose(skeleton, retract(skeleton, start, delta), problem)

    slope = jax.jit(jax.grad(energy))(jnp.zeros(39))
    step = 2e-3
    steps = step * jnp.concatenate([jnp.eye(39), -jnp.eye(39)])
    ahead, behind = jnp.split(jax.jit(jax.vmap(energy))(steps), 2)
    np.testing.assert_allclose(slope, (ahead - behind) / (2 * step), atol=0.01 * float(jnp.abs(slope).max()))


def test_it_is_a_term_like_any_other(world):
    energy = search_energy()
    hybrid = type(energy)((*energy.terms, Keypoints()))
    assert [term.name for term in hybrid.reweight(keypoints=0.5).terms][-1] == "keypoints"
    assert float(hybrid.reweight(keypoints=0.5).terms[-1].weight) == 0.5
    assert jax.tree.leaves(Keypoints())  # weight and scale are array leaves: changing them never recompiles
