"""Gauss-Newton on rows whose answer is known: points of the surface and the rays on which they truly lie."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from perturbed import perturbed, vertex_errors

from jaxmocap.character import difference, landmark_positions, retract
from jaxmocap.energies import LandmarkRays, SurfaceLines, join_lines, rays
from jaxmocap.refinement import Rows, descend, free_prior, sum_of_squares
from jaxmocap.refinement._least_squares import normal_equations
from jaxmocap.refiners import LeastSquares, Shooting
from jaxmocap.render import projection_matrices

FRAME, ROBUST = 1, 0.3


def every(value):
    return jnp.asarray(np.full(39, value, np.float32))


@pytest.fixture(scope="module")
def rows(world):
    """400 points in each of two views, tied to the rays of their true places, of which a tenth have weight 0."""
    rng = np.random.default_rng(0)
    view, faces = world.cameras.at(FRAME), np.asarray(world.character.faces)
    parts = []
    for camera in range(2):
        corners = faces[rng.choice(len(faces), 400, replace=False)]
        barycentric = rng.dirichlet(np.ones(3), 400).astype(np.float32)
        points = np.einsum("rk,rkc->rc", barycentric, world.vertices(FRAME)[corners])
        projection = projection_matrices(view.intrinsics[camera], view.cam_from_world[camera])
        pixels = np.c_[points, np.ones(400)] @ np.asarray(projection).T
        pixels = jnp.asarray(pixels[:, :2] / pixels[:, 2:], jnp.float32)
        _, direction, moment = rays(view.intrinsics[camera], view.cam_from_world[camera], pixels)
        weight = (np.arange(400) % 10 > 0).astype(np.float32)
        parts.append(
            SurfaceLines(jnp.asarray(corners), jnp.asarray(barycentric), direction, moment, jnp.asarray(weight))
        )
    return (Rows(join_lines(*parts), 0.02, ROBUST),)


def penalty(prior, delta):
    """The L1 and the pull to the prior."""
    return float(jnp.sum(prior.l1 * jnp.abs(delta)) + jnp.sum(prior.weight * (delta - prior.target) ** 2))


def test_the_truth_is_reached_from_four_degrees_away(world, rows):
    base = perturbed(world, FRAME, 4, metres=0.02)
    assert vertex_errors(world, FRAME, base).mean() > 0.03
    prior = free_prior(world.character, base, 1e-4)
    delta, hessian = descend(world.character, base, jnp.zeros(39), rows, (), prior, Shooting(), steps=8)
    found = retract(world.character.skeleton, base, delta)
    assert vertex_errors(world, FRAME, found).mean() < 0.001
    assert hessian.shape == (39, 39)
    np.testing.assert_allclose(hessian, hessian.T, rtol=1e-3, atol=1e-2 * float(jnp.abs(hessian).max()))


def test_a_step_lowers_the_objective_and_says_what_it_was(world, rows):
    base = perturbed(world, FRAME, 4, seed=1)
    prior = free_prior(world.character, base)._replace(l1=every(0.01))
    delta, values = jnp.zeros(39), []
    for _ in range(4):
        values.append(float(sum_of_squares(world.character, base, delta, rows, ())) + penalty(prior, delta))
        linearised = float(normal_equations(world.character, base, delta, rows, ()).square) + penalty(prior, delta)
        np.testing.assert_allclose(linearised, values[-1], rtol=1e-5)
        delta, _ = descend(world.character, base, delta, rows, (), prior, Shooting(), steps=1)
    assert values[1] < 0.5 * values[0]
    assert np.all(np.diff(values) <= 1e-4 * values[0])
    # By hand: squared rows after the Geman-McClure weight, the L1 and the pull to the prior.
    lines = rows[0].lines
    square = np.sum(np.asarray(lines.at(world.character, base), np.float64) ** 2, 1)
    expected = np.sum(np.asarray(lines.weight) * square / (1 + square / ROBUST**2)) / 0.02**2
    np.testing.assert_allclose(values[0], expected, rtol=1e-4)


def test_the_limits_of_the_prior_hold_and_stop_the_descent(world, rows):
    base = perturbed(world, FRAME, 4, seed=2)
    prior = free_prior(world.character, base)._replace(lower=every(-0.02), upper=every(0.02))
    prior = prior._replace(lower=prior.lower.at[30].set(0.0), upper=prior.upper.at[30].set(0.0))
    delta, _ = descend(world.character, base, jnp.zeros(39), rows, (), prior, Shooting(), steps=4)
    assert np.all(np.abs(delta) <= 0.02)
    assert np.sum(np.abs(delta) == np.float32(0.02)) > 10
    assert delta[30] == 0
    found = retract(world.character.skeleton, base, delta)
    assert vertex_errors(world, FRAME, found).mean() < vertex_errors(world, FRAME, base).mean()


def test_joint_limits_of_the_skeleton_are_the_limits_of_the_free_prior(world):
    base, skeleton = perturbed(world, FRAME, 4), world.character.skeleton
    prior = free_prior(world.character, base)
    np.testing.assert_allclose(prior.lower[6:] + base.angles, skeleton.lower, atol=1e-6)
    np.testing.assert_allclose(prior.upper[6:] + base.angles, skeleton.upper, atol=1e-6)
    assert np.all(np.asarray(prior.lower)[:6] <= -1)
    np.testing.assert_array_equal(prior.l1, 0)


def test_optimistix_and_shooting_take_the_same_step(world, rows):
    base = perturbed(world, FRAME, 3, seed=3)
    prior = free_prior(world.character, base)._replace(
        l1=every(3.0), weight=every(3.0), target=every(0.02 * np.random.default_rng(0).normal(size=39))
    )
    found = [
        descend(world.character, base, jnp.zeros(39), rows, (), prior, refiner, steps=1)[0]
        for refiner in (Shooting(), LeastSquares())
    ]
    np.testing.assert_allclose(found[0], found[1], atol=1e-3)
    assert np.abs(found[0]).max() > 0.03
    assert np.any(np.asarray(found[0]) == 0)
    left = [float(sum_of_squares(world.character, base, one, rows, ())) + penalty(prior, one) for one in found]
    np.testing.assert_allclose(left[0], left[1], rtol=1e-3)


def test_the_l1_keeps_a_body_at_rest_exactly_still(world, rows):
    """At the truth nothing pulls: every increment is zero, not merely small."""
    prior = free_prior(world.character, world.pose(FRAME), 0.0)._replace(l1=every(3.0))
    delta, _ = descend(world.character, world.pose(FRAME), jnp.zeros(39), rows, (), prior, Shooting())
    np.testing.assert_array_equal(delta, 0)


def test_landmark_rows_alone_move_the_landmarks_to_their_rays(world):
    skeleton, view = world.character.skeleton, world.cameras.at(FRAME)
    names = [
        skeleton.landmark_names.index(n) for n in ("l_wrist", "l_elbow", "l_shoulder", "r_hip", "r_knee", "r_ankle")
    ]
    places = np.asarray(landmark_positions(skeleton, world.pose(FRAME)))[names]
    mix, direction, moment = [], [], []
    for camera in range(2):
        projection = projection_matrices(view.intrinsics[camera], view.cam_from_world[camera])
        pixels = np.c_[places, np.ones(len(places))] @ np.asarray(projection).T
        pixels = jnp.asarray(pixels[:, :2] / pixels[:, 2:], jnp.float32)
        _, found, moments = rays(view.intrinsics[camera], view.cam_from_world[camera], pixels)
        mix.append(np.eye(len(skeleton.landmark_names), dtype=np.float32)[names])
        direction.append(found)
        moment.append(moments)
    lines = LandmarkRays(
        jnp.concatenate([jnp.asarray(m) for m in mix]), jnp.zeros_like(skeleton.landmarks),
        jnp.concatenate(direction), jnp.concatenate(moment),
        jnp.ones(2 * len(names)), jnp.asarray(0.02, jnp.float32), jnp.asarray(0.5, jnp.float32),
        skeleton.landmark_bodies,
    )  # fmt: skip
    base = perturbed(world, FRAME, 4, seed=4)
    prior = free_prior(world.character, base, 1e-3)
    delta, _ = descend(world.character, base, jnp.zeros(39), (), (lines,), prior, Shooting(), steps=6)
    found = np.asarray(landmark_positions(skeleton, retract(skeleton, base, delta)))[names]
    before = np.asarray(landmark_positions(skeleton, base))[names]
    assert np.linalg.norm(before - places, axis=1).mean() > 0.03
    assert np.linalg.norm(found - places, axis=1).max() < 0.004


def test_an_increment_is_taken_from_the_base_not_from_the_pose(world, rows):
    """Starting at another increment of the same base ends at the same increment."""
    base = perturbed(world, FRAME, 3, seed=5)
    prior = free_prior(world.character, base, 1e-3)
    start = difference(world.character.skeleton, base, perturbed(world, FRAME, 1, seed=6))
    first, _ = descend(world.character, base, jnp.zeros(39), rows, (), prior, Shooting(), steps=8)
    second, _ = descend(world.character, base, start, rows, (), prior, Shooting(), steps=8)
    ends = [vertex_errors(world, FRAME, retract(world.character.skeleton, base, d)).mean() for d in (first, second)]
    assert max(ends) < 0.002


def test_rows_in_parts_are_rows_in_one_and_other_scales_do_not_compile_again(world, rows, monkeypatch, tmp_path):
    monkeypatch.setenv("JAXMOCAP_PROGRAMS", str(tmp_path))
    base, lines = perturbed(world, FRAME, 4), rows[0].lines
    prior = free_prior(world.character, base)
    halves = [SurfaceLines(*(leaf[part] for leaf in jax.tree.leaves(lines))) for part in (slice(400), slice(400, None))]

    def found(*rows):
        return descend(world.character, base, jnp.zeros(39), rows, (), prior, Shooting(), steps=2)[0]

    whole = found(Rows(lines, 0.02, ROBUST))
    np.testing.assert_allclose(found(*(Rows(half, 0.02, ROBUST) for half in halves)), whole, atol=2e-5)
    known = len(list(tmp_path.iterdir()))
    assert known > 0 or jax.default_backend() != "cpu"  # programs for other devices are not kept
    wider = found(Rows(lines, 0.03, 2 * ROBUST))
    assert len(list(tmp_path.iterdir())) == known
    assert np.abs(wider - whole).max() > 1e-4
