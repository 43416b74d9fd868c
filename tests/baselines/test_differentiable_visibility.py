"""The energy of visible Gaussians: what it counts, its gradient, and a limb that it brings back."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmocap.baselines import DifferentiableVisibility, GaussianVisibility, descend, gaussian_visibility, method
from jaxmocap.character import clamp, difference, retract, skin
from jaxmocap.energies import SearchEnergy, soft_score
from jaxmocap.geometry import intersection_over_union
from jaxmocap.observation import draw
from jaxmocap.render import SoftSettings
from jaxmocap.search import PoseScore

FRAME, STEP = 2, 4


@pytest.fixture(scope="module")
def term(world) -> GaussianVisibility:
    return gaussian_visibility(world.character, world.observations().surface, 150, step=STEP, weight=10.0)


@pytest.fixture(scope="module")
def painted(world, term):
    """The frame as the Gaussians themselves would show it: psi_b is 1 where the body is seen and 0 beside it, and a
    table of two colours, one of them the body's."""
    problem = world.problem(FRAME)
    covered = draw(world.character, world.pose(FRAME), problem)[1] >= 0
    two = jnp.broadcast_to(jnp.array([1.0, 0.0]), (*term.distances.shape[:2], 2))
    labels, background = covered.astype(jnp.int32), covered.astype(jnp.float32)
    return eqx.tree_at(lambda t: t.distances, term, two), replace(problem, labels=labels, background=background)


@eqx.filter_jit
def value(term, skeleton, pose, problem):
    return term.score_pose(skeleton, pose, problem)


@eqx.filter_jit
def gradient(term, skeleton, pose, problem):
    return jax.grad(lambda delta: term.score_pose(skeleton, retract(skeleton, pose, delta), problem))(
        jnp.zeros(skeleton.num_dofs)
    )


def off(world, name: str, degrees: float):
    """The true pose with a limb bent in every joint."""
    skeleton = world.character.skeleton
    bent = np.zeros(39, np.float32)
    bent[[*skeleton.group(name)]] = np.radians(degrees)
    return clamp(skeleton, retract(skeleton, world.pose(FRAME), jnp.asarray(bent)))


def gaps(world, pose) -> np.ndarray:
    """Distances of the skin from where it is, centimetres."""
    return 100 * np.linalg.norm(np.asarray(skin(world.character, pose)) - world.vertices(FRAME), axis=1)


@pytest.fixture(scope="module")
def silhouette(world, term):
    """The Gaussians' at the true pose, every fourth pixel."""
    return np.asarray(
        eqx.filter_jit(term.silhouette)(world.character.skeleton, world.pose(FRAME), world.problem(FRAME))
    )


def test_the_silhouette_of_the_gaussians_is_about_the_mesh_s(world, silhouette):
    covered = np.asarray(draw(world.character, world.pose(FRAME), world.problem(FRAME))[1])[:, ::STEP, ::STEP] >= 0
    assert silhouette.sum() / covered.sum() == pytest.approx(1.0, abs=0.05)
    assert intersection_over_union(np.concatenate(silhouette > 0.5), np.concatenate(covered)) > 0.9


def test_a_body_out_of_sight_pays_for_the_background_and_for_hiding_beside_the_rectangle_of_a_larger_picture(
    world, term
):
    """Nothing is in front of the pixels, and every Gaussian lies beside the rectangle, in the picture or beyond it."""
    problem, skeleton = world.problem(FRAME), world.character.skeleton
    larger = replace(problem, pictures=jnp.full_like(problem.pictures, 1e5))
    away = retract(skeleton, world.pose(FRAME), jnp.zeros(39).at[0].set(30.0))
    behind = float(problem.background[:, ::STEP, ::STEP].sum() * STEP**2 / problem.area)
    assert float(value(replace(term, outside=0.0), skeleton, away, problem)) == pytest.approx(behind, rel=1e-5)
    assert float(value(term, skeleton, away, problem)) == pytest.approx(behind, rel=1e-5)
    assert float(value(term, skeleton, away, larger)) > behind + 0.01


def test_every_pixel_is_looked_at_wherever_a_gaussian_is(world, term, silhouette):
    """With psi_f of 0 and psi_b of 1 the energy is what the silhouette leaves."""
    problem, skeleton, pose = world.problem(FRAME), world.character.skeleton, world.pose(FRAME)
    plain = replace(problem, background=jnp.ones_like(problem.background))
    all_alike = eqx.tree_at(lambda t: t.distances, replace(term, outside=0.0), jnp.zeros_like(term.distances))
    found = float(value(all_alike, skeleton, pose, plain))
    assert found == pytest.approx(float(STEP**2 * (1 - silhouette).sum() / problem.area), rel=1e-3)


@pytest.mark.slow
def test_the_search_scores_what_is_followed_downhill(world, term):
    pose, problem = off(world, "l_arm", 5.0), world.problem(FRAME)
    (hard,), _ = PoseScore(SearchEnergy((term,)), world.character)(problem, [pose])
    bounds = SoftSettings(1.0, 12, 4096, 16384, 40960)
    soft = eqx.filter_jit(soft_score)(SearchEnergy((term,)), world.character, pose, problem, bounds)
    assert float(soft.total) == pytest.approx(float(hard), rel=1e-5)


def test_the_gradient_is_that_of_differences(world, term):
    """Rays that meet only eight Gaussians are off by 4 % here: which eight they are has no slope."""
    term = replace(term, nearest=16)
    skeleton, problem = world.character.skeleton, world.problem(FRAME)
    away = np.random.default_rng(0).normal(0, 0.03, 39).astype(np.float32)
    pose = retract(skeleton, world.pose(FRAME), jnp.asarray(away))
    slope = np.asarray(gradient(term, skeleton, pose, problem))
    steep, step = float(np.linalg.norm(slope)), 3e-3
    for way in (slope / steep, *np.random.default_rng(1).normal(0, 1, (2, 39)) / np.sqrt(39)):
        ends = [
            float(value(term, skeleton, retract(skeleton, pose, jnp.asarray(s * way)), problem)) for s in (step, -step)
        ]
        assert (ends[0] - ends[1]) / (2 * step) == pytest.approx(float(slope @ way), abs=0.03 * steep)


@pytest.mark.slow
@pytest.mark.parametrize("limb", ["l_arm", "r_arm", "l_leg", "r_leg"])
def test_downhill_leads_a_bent_limb_home(world, painted, limb):
    """The slope in the limb's own degrees of freedom, and the energy at both ends."""
    (term, problem), skeleton = painted, world.character.skeleton
    start, own = off(world, limb, 5.0), [*skeleton.group(limb)]
    falling = -np.asarray(gradient(term, skeleton, start, problem))[own]
    home = np.asarray(difference(skeleton, start, world.pose(FRAME)))[own]
    assert falling @ home > 0.2 * np.linalg.norm(falling) * np.linalg.norm(home)
    assert value(term, skeleton, world.pose(FRAME), problem) < value(term, skeleton, start, problem)


@pytest.mark.slow
def test_a_bent_arm_comes_back(world):
    """From the picture as it was filmed; two views leave a centimetre of depth."""
    skeleton, start, problem = world.character.skeleton, off(world, "l_arm", 5.0), world.problem(FRAME)
    fine = gaussian_visibility(world.character, problem.surface, 300, step=2, weight=10.0)
    arm = np.isin(np.asarray(world.character.weights).argmax(1), np.flatnonzero(skeleton.bodies_of("l_arm")))
    found, energy = descend(fine, skeleton, start, problem, 60, 1e-4)
    assert float(energy) < 10.0 * float(value(fine, skeleton, start, problem))
    assert gaps(world, start)[arm].mean() > 5.0
    assert gaps(world, found)[arm].mean() < 2.0
    assert gaps(world, found).mean() < 1.2


@pytest.mark.slow
def test_the_baseline_comes_nearer_to_the_next_frame(world):
    """As a user calls it, from the truth of the frame before."""
    baseline = method("differentiable-visibility")
    assert isinstance(baseline, DifferentiableVisibility)
    worker = baseline.follow(world.observations(), jax.random.key(0))
    state = worker.first(world.shown(1), world.pose(1)).state
    found = worker.track(state, world.shown(2)).result.pose
    assert gaps(world, found).mean() < gaps(world, world.pose(1)).mean()
