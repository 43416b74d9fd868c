"""A person who sways while being filmed: how far from view to view, and the surface in the mean pose all the same."""

import numpy as np
import pytest
import trimesh
from scipy.spatial import KDTree
from test_scan import ring

from jaxmocap.character import Pose, skin
from jaxmocap.scan import Views, reconstruct, visual_hull
from jaxmocap.scan._hull import mask_distances
from jaxmocap.scan._surface import draw_views
from jaxmocap.scan._sway import estimate_sway, sway_at_rest
from jaxmocap.synthetic import make_actor, stand

VIEWS, WIDTH, HEIGHT, SWAY = 20, 240, 400, 0.03


def filmed(sway: float) -> tuple[Views, np.ndarray, np.ndarray]:
    """Silhouettes of the actor during a lap, its surface at rest (the mean pose), and its moves in each view."""
    actor, poses = make_actor(), ring(VIEWS)[1]
    rest, faces = np.asarray(actor.vertices, float), np.asarray(actor.faces)
    for pose in poses:
        pose[:3, 3] = [0, 0.9, 2.5]
    places = stand(actor.skeleton, np.linspace(0, 30, VIEWS), sway, seed=3)
    bodies = [np.asarray(skin(actor, Pose(*one)), float) for one in zip(places.root, places.angles, strict=True)]
    intrinsics = np.tile([[460.0, 0, WIDTH / 2], [0, 460.0, HEIGHT / 2], [0, 0, 1]], (VIEWS, 1, 1))
    views = Views(np.zeros((VIEWS, HEIGHT, WIDTH), np.uint8), np.zeros((VIEWS, HEIGHT, WIDTH), bool), intrinsics, poses)
    for number, body in enumerate(bodies):
        only = views.only(np.arange(VIEWS) == number)
        views.masks[number] = draw_views(body, faces, only)[0].ids >= 0
    return views, rest, np.stack(bodies) - rest


def across(views: Views, moves: np.ndarray) -> np.ndarray:
    """What of moves a view sees: that across its axis."""
    return np.einsum("vij,vpj->vpi", views.cam_from_world[:, :2, :3], moves)


@pytest.fixture(scope="module")
def swaying():
    return filmed(SWAY)


@pytest.fixture(scope="module")
def skeleton(swaying):
    return sway_at_rest(swaying[1], np.asarray(make_actor().faces), VIEWS)


def found(views: Views, rest: np.ndarray, sway, used=np.ones(VIEWS, bool)):
    faces = np.asarray(make_actor().faces)
    for _ in range(3):
        drawn = draw_views(rest, faces, views._replace(sway=sway))
        sway = estimate_sway(sway, rest, faces, drawn, mask_distances(views.masks), used)
    return sway


@pytest.mark.slow
def test_outlines_tell_how_the_body_moves_across_each_view(swaying, skeleton):
    views, rest, moves = swaying
    sway = found(views, rest, skeleton)
    true, off = across(views, moves), across(views, sway.moves(rest) - moves)
    upper = rest[:, 1] > 0.8
    assert np.sqrt((true[:, upper] ** 2).mean()) > 0.01
    assert np.sqrt((off[:, upper] ** 2).mean()) < 0.3 * np.sqrt((true[:, upper] ** 2).mean())
    feet = rest[:, 1] < 0.05
    assert np.abs(sway.moves(rest)[:, feet]).mean() < 0.003
    assert np.abs(sway.amounts.mean(axis=0)).max() < 1e-9


@pytest.mark.slow
def test_a_view_that_is_not_used_follows_its_neighbours(swaying, skeleton):
    views, rest, _ = swaying
    used = np.arange(VIEWS) != 7
    spoilt = views._replace(masks=views.masks & used[:, None, None])
    sway = found(spoilt, rest, skeleton, used)
    placed = sway.moves(rest)[:, rest[:, 1] > 1.5].mean(axis=1)
    assert np.linalg.norm(placed[7]) > 0
    assert np.linalg.norm(placed[7] - 0.5 * (placed[6] + placed[8])) < 0.01


@pytest.mark.slow
def test_somebody_who_stands_still_is_found_to(skeleton):
    views, rest, _ = filmed(0.0)
    assert found(views, rest, skeleton).extent < 0.002


@pytest.mark.slow
def test_a_hull_of_somebody_who_sways_is_that_of_the_mean_pose(swaying):
    views, rest, _ = swaying
    truth = trimesh.sample.sample_surface(trimesh.Trimesh(rest, make_actor().faces, process=False), 50_000, seed=0)[0]
    away = {}
    for looked_for in (False, True):
        made = reconstruct(views, rounds=0, swaying=looked_for)
        away[looked_for] = np.mean(KDTree(made.vertices).query(truth)[0])
        assert (made.sway is not None) == looked_for
    assert away[True] < 0.7 * away[False]
    thin, _ = visual_hull(views)
    assert np.abs(thin).max(axis=0)[0] < np.abs(made.vertices).max(axis=0)[0]  # hands are carved off
