"""Sums of Gaussians: the body, the energy and its ascent against what can be known."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmocap.baselines import GaussianBody, SumsEnergy, SumsOfGaussians, colour_similarity, conditioned_ascent
from jaxmocap.camera import View, project
from jaxmocap.character import dominant_bodies, retract, skin
from jaxmocap.geometry import matmul, rigid, so3_exp

FRAME = 2
FIVE_DEGREES = np.radians(5.0).astype(np.float32)


@pytest.fixture(scope="module")
def worker(world):
    return SumsOfGaussians().follow(world.observations(), jax.random.key(0))


def energy_of(world, view: View, body: GaussianBody, centres, sigmas, similarity) -> SumsEnergy:
    """The energy of pictures made by hand, without penalties, at the true pose."""
    centres, sigmas, similarity = (jnp.asarray(array, jnp.float32) for array in (centres, sigmas, similarity))
    return SumsEnergy(
        character=world.character,
        body=body,
        pose=world.pose(FRAME),
        intrinsics=view.intrinsics,
        cam_from_world=view.cam_from_world,
        centres=centres,
        sigmas=sigmas,
        similarity=similarity,
        area=jnp.sum(jnp.pi * sigmas**2, -1),
        limits=jnp.zeros(()),
        acceleration=jnp.zeros(()),
    )


def seen_by(world, view: View, body: GaussianBody) -> tuple[np.ndarray, np.ndarray]:
    """Where the body's Gaussians are in the pictures at the true pose, and how wide, pixels."""
    pixels, depth = project(view.intrinsics, view.cam_from_world, body.posed(world.character, world.pose(FRAME)))
    return np.asarray(pixels), np.asarray(view.intrinsics)[:, :1, 0] * np.asarray(body.sigmas) / np.asarray(depth)


def all_around(world, count: int) -> View:
    """The first camera at so many places around the person."""
    view, middle = world.cameras.at(FRAME), world.vertices(FRAME).mean(0)
    turns = [np.asarray(so3_exp(jnp.array([0.0, 2 * jnp.pi * k / count, 0.0]))) for k in range(count)]
    moved = jnp.stack([matmul(view.cam_from_world[0], rigid(turn, middle - turn @ middle)) for turn in turns])
    return View(jnp.repeat(view.intrinsics[:1], count, 0), moved)


def lone(body: GaussianBody) -> GaussianBody:
    """The first Gaussian alone."""
    return GaussianBody(body.centres[:1], body.sigmas[:1], body.bones[:1], body.colours[:, :1])


def test_the_body_is_filled_and_coloured(world, worker):
    body, character = worker.memory, world.character
    assert 100 < len(body.sigmas) <= 200  # those that no selected frame shows are left out
    assert 0.01 < float(body.sigmas.min()) < float(body.sigmas.max()) < 0.04
    owners = np.asarray(body.bones).argmax(1)
    assert set(np.unique(dominant_bodies(character))) == set(owners)
    vertices = np.asarray(character.vertices)
    inside = (np.asarray(body.centres) > vertices.min(0)) & (np.asarray(body.centres) < vertices.max(0))
    assert inside.all()
    head = np.asarray(body.colours)[:, owners == character.skeleton.body_names.index("head"), 2]
    assert head.min() < 0.5 < head.max()  # hair and skin


def test_an_overlap_is_the_integral_of_the_product(world, worker):
    body, view, size = lone(worker.memory), View(*(leaf[:1] for leaf in jax.tree.leaves(world.cameras.at(FRAME)))), 1.7
    pixels, widths = seen_by(world, view, body)
    centres = pixels + np.array([2.0, -1.5])
    energy = energy_of(world, view, body, centres, np.full((1, 1), size), np.full((1, 1, 1), 0.4))
    step = 0.05
    rows, columns = np.mgrid[-30:30:step, -30:30:step]
    picture = np.exp(-0.5 * ((columns - 2.0) ** 2 + (rows + 1.5) ** 2) / size**2)
    drawn = np.exp(-0.5 * (columns**2 + rows**2) / widths[0, 0] ** 2)
    expected = 0.4 * np.sum(picture * drawn) * step**2 / (np.pi * size**2)
    assert 0.05 < expected < 0.9
    assert float(energy(jnp.zeros(39))) == pytest.approx(expected, rel=1e-3)


def test_nothing_is_explained_twice(world, worker):
    body, view = lone(worker.memory), world.cameras.at(FRAME)
    many = GaussianBody(*(jnp.repeat(leaf, 20, 1 if leaf.ndim == 3 else 0) for leaf in jax.tree.leaves(body)))
    pixels, _ = seen_by(world, view, body)
    energy = energy_of(world, view, many, pixels, np.full((2, 1), 2.0), np.ones((2, 1, 20)))
    assert float(energy(jnp.zeros(39))) == pytest.approx(1.0, abs=1e-6)


def test_colours_are_alike_up_to_a_distance():
    body = np.zeros((1, 3))
    colours = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.2, 0.0], [1.0, 1.0, 1.0]])
    np.testing.assert_allclose(colour_similarity(colours, body, 0.2)[:, 0], [1.0, 3 / 16, 0.0, 0.0], atol=1e-12)


def test_the_gradient_is_that_of_differences(world, worker):
    away = np.random.default_rng(0).normal(0, 0.02, 39).astype(np.float32)
    pose = retract(world.character.skeleton, world.pose(FRAME), jnp.asarray(away))
    baseline = SumsOfGaussians(limits=1.0, acceleration=0.5)
    energy = jax.jit(baseline.energy(worker, world.frame(FRAME), pose).__call__)
    slope = np.asarray(jax.grad(energy)(jnp.asarray(away)))
    steep, step = float(np.linalg.norm(slope)), 4e-3
    for way in (slope / steep, *np.random.default_rng(1).normal(0, 1, (2, 39)) / np.sqrt(39)):
        measured = (float(energy(away + step * way)) - float(energy(away - step * way))) / (2 * step)
        assert measured == pytest.approx(float(slope @ way), abs=0.03 * steep)


@pytest.mark.slow
def test_pictures_of_the_gaussians_themselves_bring_the_pose_back(world, worker):
    """With exact colours, squares and cameras all around the truth explains all there is, and is found again."""
    body, skeleton, view = worker.memory, world.character.skeleton, all_around(world, 4)
    alike = np.broadcast_to(np.eye(len(body.sigmas)), (4, len(body.sigmas), len(body.sigmas)))
    energy = energy_of(world, view, body, *seen_by(world, view, body), alike)
    assert float(energy(jnp.zeros(39))) == pytest.approx(1.0, abs=1e-4)
    bent = np.zeros(39, np.float32)
    bent[list(skeleton.group("l_arm"))] = FIVE_DEGREES
    start = retract(skeleton, world.pose(FRAME), jnp.asarray(bent))
    found = retract(skeleton, start, conditioned_ascent(replace(energy, pose=start), 100, 0.1))
    off = lambda pose: 100 * np.linalg.norm(np.asarray(skin(world.character, pose)) - world.vertices(FRAME), axis=1)  # noqa: E731
    assert off(start).max() > 8.0
    assert off(found).max() < 1.0


@pytest.mark.slow
def test_two_views_of_stripes_hold_the_body_to_two_centimetres(world, worker):
    """A body of blobs of one colour each fits stripes best where it is nearer to two cameras on one side."""
    baseline, pose = worker.baseline, world.pose(FRAME)
    found = np.asarray(skin(world.character, baseline.find(worker, world.frame(FRAME), pose)))
    assert np.linalg.norm(found - world.vertices(FRAME), axis=1).mean() < 0.02
