"""Correspondences carried over the surface pull a perturbed pose to the truth."""

import cv2
import jax.numpy as jnp
import numpy as np
import pytest
from perturbed import perturbed, vertex_errors

from jaxmocap.character import retract
from jaxmocap.observation import draw
from jaxmocap.refinement import FlowSettings, Rows, current_views, descend, free_prior, known_view, surface_flow
from jaxmocap.refinement._compare import textured
from jaxmocap.refinement._surface_flow import pick_samples
from jaxmocap.refiners import Shooting

FRAME, SELECTED = 2, 1
SETTINGS = FlowSettings()


@pytest.fixture(scope="module")
def selected_sources(world):
    """The selected frame, whose pose is known, as seen by each camera."""
    images, pose = world.truth.images[SELECTED], world.pose(SELECTED)
    return [[known_view(world.character, world.cameras, images[c], SELECTED, c, pose)] for c in range(2)]


def views_at(world, pose):
    """The views of the frame at a pose."""
    vertices, ids, _ = draw(world.character, pose, world.problem(FRAME))
    crops = [world.rectangle(FRAME).crop(image, c) for c, image in enumerate(world.shown(FRAME).images)]
    return current_views(crops, world.problem(FRAME), vertices, ids)


def other_view_sources(world, pose):
    """Each camera's other camera at the same frame, at the pose being refined."""
    return [[view] for view in reversed(views_at(world, pose))]


def rows_at(world, pose, sources, settings=SETTINGS):
    views, near_faces = views_at(world, pose), world.problem(FRAME).surface.near_faces
    return surface_flow(world.character.faces, near_faces, views, sources, settings), views[0].vertices


def descended(world, pose, lines):
    prior = free_prior(world.character, pose, jnp.concatenate([jnp.full(6, 0.1), jnp.full(33, 0.5)]))
    rows = tuple(Rows(found, 0.02, 0.03) for found in lines)
    delta, _ = descend(world.character, pose, jnp.zeros(39), rows, (), prior, Shooting(), steps=3)
    return retract(world.character.skeleton, pose, delta)


@pytest.mark.parametrize(("kind", "degrees"), [("joints", 2.5), ("root", 2.5), ("limbs", 3)])
def test_one_descent_halves_the_error_of_perturbed_poses(world, selected_sources, kind, degrees):
    before, after = [], []
    for seed in range(3):
        pose = perturbed(world, FRAME, degrees, seed, kind)
        lines, _ = rows_at(world, pose, selected_sources)
        before.append(vertex_errors(world, FRAME, pose).mean())
        after.append(vertex_errors(world, FRAME, descended(world, pose, lines)).mean())
    assert min(before) > 0.012
    assert np.mean(after) < 0.5 * np.mean(before)
    assert np.all(np.array(after) < 0.75 * np.array(before))


def test_rows_at_the_truth_ask_for_millimetres(world, selected_sources):
    lines, vertices = rows_at(world, world.pose(FRAME), selected_sources)
    assert len(lines) == 2
    for found in lines:
        assert found.weight.shape == (SETTINGS.samples,)
        weight = np.asarray(found.weight)
        assert np.all((weight >= 0) & (weight <= 1))
        assert (weight > 0).mean() > 0.9
        distance = np.linalg.norm(found.residual(vertices), axis=1)[weight > 0]
        assert np.median(distance) < 0.002  # a pixel is about 6 mm
    after = descended(world, world.pose(FRAME), lines)
    assert vertex_errors(world, FRAME, after).mean() < 0.004


def test_the_other_view_at_the_truth_asks_for_millimetres(world):
    pose = world.pose(FRAME)
    lines, vertices = rows_at(world, pose, other_view_sources(world, pose))
    assert len(lines) == 4  # per view: where it should be seen here, and where the other view sees it
    for found in lines:
        distance = np.linalg.norm(found.residual(vertices), axis=1)[np.asarray(found.weight) > 0]
        assert np.median(distance) < 0.004


def test_the_other_view_pulls_a_body_back_in_depth(world):
    """Eq. 7 as least squares: the body is moved 4 cm along the mean viewing direction."""
    centre = np.asarray(world.cameras.centres())[:, FRAME].mean(0)
    away = world.vertices(FRAME).mean(0) - centre
    away /= np.linalg.norm(away)
    delta = jnp.zeros(39).at[:3].set(jnp.asarray(0.04 * away, jnp.float32))
    pose = retract(world.character.skeleton, world.pose(FRAME), delta)
    for _ in range(2):
        pose = descended(world, pose, rows_at(world, pose, other_view_sources(world, pose))[0])
    left = (np.asarray(pose.root[:3, 3]) - np.asarray(world.pose(FRAME).root[:3, 3])) @ away
    assert abs(left) < 0.02


def test_a_body_that_the_source_does_not_see_gives_rows_of_weight_zero(world, selected_sources):
    far = [[s._replace(vertices=s.vertices + np.array([40.0, 0, 0], np.float32))] for (s,) in selected_sources]
    lines, vertices = rows_at(world, world.pose(FRAME), far)
    for found in lines:
        assert found.weight.shape == (SETTINGS.samples,)
        np.testing.assert_array_equal(found.weight, 0)
        assert np.all(np.isfinite(found.residual(vertices)))


def test_a_darker_source_is_brought_to_the_brightness_of_the_view(world, selected_sources):
    dark = [[s._replace(image=(0.7 * s.image).astype(np.uint8))] for (s,) in selected_sources]
    lines, vertices = rows_at(world, world.pose(FRAME), dark)
    for found in lines:
        weight = np.asarray(found.weight)
        assert (weight > 0).mean() > 0.9
        assert np.median(np.linalg.norm(found.residual(vertices), axis=1)[weight > 0]) < 0.003


def test_a_picture_that_tells_nothing_has_no_negative_weight():
    """Rounding makes the smaller eigenvalue negative along some edges, and a negative weight spoils every row."""
    rng, lowest = np.random.default_rng(0), 0.0
    for _ in range(20):
        slope = np.add.outer(rng.normal() * np.arange(200), rng.normal() * np.arange(240))
        edge = np.where(slope > 20, rng.integers(100, 255), rng.integers(100)).astype(np.uint8)
        lowest = min(lowest, cv2.cornerMinEigenVal(cv2.GaussianBlur(edge, (0, 0), 1.0), 9, ksize=3).min())
        assert textured(edge).min() >= 0
        assert np.median(textured(edge)) < 0.1
    assert lowest < 0
    assert textured(rng.integers(0, 255, (200, 240)).astype(np.uint8)).min() > 0.5


def test_samples_are_spread_evenly_and_filled_up_with_zero():
    good = np.zeros((20, 20), bool)
    good[5:15, 5:15] = True
    picked = pick_samples(good, 25)
    assert len(set(picked)) == 25
    assert good.reshape(-1)[picked].all()
    np.testing.assert_allclose(np.diff(np.searchsorted(np.flatnonzero(good), picked)), 4)
    few = pick_samples(good, 130)
    np.testing.assert_array_equal(few[:100], np.flatnonzero(good))
    np.testing.assert_array_equal(few[100:], 0)
