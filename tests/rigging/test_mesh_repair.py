"""Repair of surfaces whose volume is known."""

import numpy as np
import pytest
import trimesh

from jaxmocap import InputError
from jaxmocap.rigging._read_mesh import axis_name, metres_per_unit
from jaxmocap.rigging._repair import repair

BALL = trimesh.creation.icosphere(4, radius=0.8)  # 5,120 triangles
VERTICES, FACES = np.asarray(BALL.vertices), np.asarray(BALL.faces)


def closed(vertices, faces, volume=BALL.volume, tolerance=0.01):
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.volume == pytest.approx(volume, rel=tolerance)


def test_a_clean_mesh_is_left_alone():
    clean = repair(VERTICES, FACES, 6000)
    assert clean.done == []
    np.testing.assert_allclose(np.sort(clean.vertices, axis=0), np.sort(VERTICES, axis=0), atol=1e-12)
    closed(clean.vertices, clean.faces, tolerance=1e-9)


def test_triangles_that_share_nothing_are_welded():
    soup = VERTICES[FACES].reshape(-1, 3)
    clean = repair(soup, np.arange(len(soup)).reshape(-1, 3), 6000)
    assert len(clean.vertices) == len(VERTICES)
    assert any("welded" in words for words in clean.done)
    closed(clean.vertices, clean.faces, tolerance=1e-9)


@pytest.mark.parametrize("share", [0.4, 1.0])
def test_triangles_are_turned_outwards(share):
    inside = np.random.default_rng(0).random(len(FACES)) < share
    clean = repair(VERTICES, np.where(inside[:, None], FACES[:, ::-1], FACES), 6000)
    assert f"turned {inside.sum():,} triangles to face outwards" in clean.done
    closed(clean.vertices, clean.faces, tolerance=1e-9)


def test_holes_are_closed():
    gone = np.random.default_rng(0).random(len(FACES)) < 0.1
    gone |= VERTICES[FACES].mean(axis=1)[:, 1] < -0.75
    clean = repair(VERTICES, FACES[~gone], 6000)
    assert any("holes" in words for words in clean.done)
    closed(clean.vertices, clean.faces)


def test_specks_and_what_floats_afar_are_dropped():
    speck, other = trimesh.creation.icosphere(1, radius=0.01), trimesh.creation.icosphere(2, radius=0.3)
    parts = [BALL, speck.apply_translation([0.8, 0, 0]), other.apply_translation([3, 0, 0])]
    all_of_it = trimesh.util.concatenate(parts)
    clean = repair(np.asarray(all_of_it.vertices), np.asarray(all_of_it.faces), 6000)
    assert any("dropped 2 of 3 separate parts" in words for words in clean.done)
    closed(clean.vertices, clean.faces, tolerance=1e-9)


def test_fins_on_edges_are_dropped():
    fins = np.column_stack([FACES[:40, :2], FACES[40:80, 0]])
    fins = fins[[len(set(fin)) == 3 for fin in fins.tolist()]]
    clean = repair(VERTICES, np.concatenate([FACES, fins]), 6000)
    assert any("edges that had three" in words for words in clean.done)
    edges = np.sort(trimesh.Trimesh(clean.vertices, clean.faces, process=False).edges, axis=1)
    assert np.unique(edges, axis=0, return_counts=True)[1].max() == 2


def test_places_that_are_no_numbers_are_dropped():
    spoiled = VERTICES.copy()
    spoiled[7] = np.nan
    clean = repair(spoiled, FACES, 6000)
    assert np.all(np.isfinite(clean.vertices))
    closed(clean.vertices, clean.faces)


@pytest.mark.parametrize("subdivisions", [6, 7])
def test_large_meshes_are_simplified(subdivisions):
    """82 thousand triangles by collapsing edges, 328 thousand through a grid first."""
    ball = trimesh.creation.icosphere(subdivisions, radius=0.8)
    clean = repair(np.asarray(ball.vertices), np.asarray(ball.faces), 3000)
    assert 2700 < len(clean.faces) < 3300
    assert any("simplified" in words for words in clean.done)
    mesh = trimesh.Trimesh(clean.vertices, clean.faces, process=False)
    assert mesh.volume == pytest.approx(ball.volume, rel=0.02)
    assert np.abs(np.linalg.norm(clean.vertices, axis=1) - 0.8).max() < 0.02


def test_too_little_is_refused():
    with pytest.raises(InputError, match="50 usable triangles"):
        repair(VERTICES, FACES[:50], 5000)


@pytest.mark.parametrize(("tall", "unit"), [(1.7, "m"), (170, "cm"), (1700, "mm"), (67, "in"), (5.6, "ft"), (17, "dm")])
def test_units_are_those_that_make_an_adult(tall, unit):
    factor, name = metres_per_unit("scan.obj", tall, None, None)
    assert name == unit
    assert 1.6 < factor * tall < 1.8


def test_a_height_decides_and_nonsense_is_refused():
    assert metres_per_unit("scan.obj", 34.0, 1.7, None) == (pytest.approx(0.05), "from the height")
    assert metres_per_unit("scan.obj", 0.8, None, None) == (1.0, "m")  # a child
    with pytest.raises(InputError, match=r"scan\.obj is 34 units tall"):
        metres_per_unit("scan.obj", 34.0, None, None)
    with pytest.raises(InputError, match="height is 17 m"):
        metres_per_unit("scan.obj", 34.0, 17.0, None)
    with pytest.raises(InputError, match=r"0\.0017 m tall in mm"):
        metres_per_unit("scan.obj", 1.7, None, "mm")


def test_axes_have_names():
    assert axis_name(np.array([0, -2.0, 0])) == "-y"
    assert axis_name(np.array([0.6, 0.8, 0])) == "0.60 0.80 0.00"
