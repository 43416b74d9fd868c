"""The colours of the drawn body against the picture, hard and soft."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmocap.baselines import RenderedColours, differentiable_rendering
from jaxmocap.character import clamp, retract, skin
from jaxmocap.energies import SearchEnergy, soft_score
from jaxmocap.observation import draw
from jaxmocap.render import SoftSettings
from jaxmocap.search import PoseScore, polish

FRAME = 2
ENERGY = SearchEnergy((RenderedColours(),))
BOUNDS = (4096, 16384, 40960)


@pytest.fixture(scope="module")
def painted(world):
    """The frame with every pixel of the person in the mean colour of its face, and of one known colour elsewhere."""
    problem = world.problem(FRAME)
    known = replace(problem.surface, has_colour=jnp.ones_like(problem.surface.has_colour))
    ids = draw(world.character, world.pose(FRAME), problem)[1]
    colours = known.mean_colour[jnp.arange(2)[:, None, None], jnp.maximum(ids, 0)]
    return replace(problem, surface=known, image=jnp.where(ids[..., None] >= 0, colours, 0.5))


@pytest.fixture(scope="module")
def off(world):
    """A pose some degrees away from the truth, where every degree of freedom has a slope."""
    away = np.random.default_rng(0).normal(0, 0.03, 39).astype(np.float32)
    return retract(world.character.skeleton, world.pose(FRAME), jnp.asarray(away))


@eqx.filter_jit
def soft(character, pose, problem, settings):
    return soft_score(ENERGY, character, pose, problem, settings)


def test_a_picture_of_the_body_itself_costs_nothing(world, painted, off):
    (true, wrong), _ = PoseScore(ENERGY, world.character)(painted, [world.pose(FRAME), off])
    assert true < 0.02
    assert wrong > 1.0


def test_a_picture_one_tenth_brighter_costs_three(world, painted):
    brighter = replace(painted, image=painted.image + 0.1)
    totals, _ = PoseScore(ENERGY, world.character)(brighter, [world.pose(FRAME)])
    assert totals[0] == pytest.approx(3.0, abs=0.05)  # 100 times 0.1^2 in three channels


@pytest.mark.slow
def test_soft_colours_tend_to_the_hard_ones(world, off):
    problem = world.problem(FRAME)
    (hard,), _ = PoseScore(ENERGY, world.character)(problem, [off])
    wide, narrow = (soft(world.character, off, problem, SoftSettings(width, 12, *BOUNDS)) for width in (1.0, 0.01))
    assert np.all(np.asarray(wide.needed) <= BOUNDS)
    assert abs(float(narrow.total) - hard) < 0.02
    assert abs(float(narrow.total) - hard) < abs(float(wide.total) - hard) < 1.0


@pytest.mark.slow
def test_the_gradient_is_that_of_differences(world, off):
    problem, skeleton = world.problem(FRAME), world.character.skeleton
    settings = SoftSettings(2.0, 12, *BOUNDS)

    def value(delta):
        return soft_score(ENERGY, world.character, retract(skeleton, off, delta), problem, settings).total

    one, slope = jax.jit(value), np.asarray(jax.grad(value)(jnp.zeros(39)))
    rng, step = np.random.default_rng(1), 2e-3
    for _ in range(3):
        way = (rng.normal(0, 1, 39) * np.where(np.arange(39) < 3, 0.3, 1.0)).astype(np.float32)
        measured = (float(one(step * way)) - float(one(-step * way))) / (2 * step)
        assert measured == pytest.approx(float(slope @ way), rel=0.05, abs=0.01 * float(np.linalg.norm(slope)))


@pytest.mark.slow
def test_a_limb_five_degrees_off_comes_back(world):
    tracker, skeleton = differentiable_rendering(), world.character.skeleton
    bent = np.zeros(39, np.float32)
    bent[[*skeleton.group("l_leg")]] = np.radians(5.0)
    start = clamp(skeleton, retract(skeleton, world.pose(FRAME), jnp.asarray(bent)))
    found, before, after = polish(tracker.scored, world.character, start, world.problem(FRAME), tracker.polish)
    gap = lambda pose: 100 * np.linalg.norm(np.asarray(skin(world.character, pose)) - world.vertices(FRAME), axis=1)  # noqa: E731
    leg = np.isin(np.asarray(world.character.weights).argmax(1), np.flatnonzero(skeleton.bodies_of("l_leg")))
    assert gap(start)[leg].mean() > 3.0
    assert gap(found)[leg].mean() < 1.0
    assert gap(found).mean() < 0.7
    assert after < before
