"""Meshes filled up to a common number of faces: they score as before, and have the same shapes."""

from dataclasses import replace

import jax
import numpy as np
import pytest

from jaxmocap.character import filled_up, simplify
from jaxmocap.energies import search_energy
from jaxmocap.observation import filled_surface, simplified_surface
from jaxmocap.search import PoseScore, group_searches
from jaxmocap.search._drawn_meshes import simplified_mesh

FRAME = 2


@pytest.mark.slow
def test_a_filled_up_mesh_scores_as_the_mesh_itself(world):
    filled, problem = filled_up(world.character), world.problem(FRAME)
    poses = [world.pose(FRAME), world.pose(FRAME + 1)]
    surface = filled_surface(problem.surface, filled.faces.shape[0])
    totals, terms = PoseScore(search_energy(), world.character)(problem, poses)
    again, terms_again = PoseScore(search_energy(), filled)(replace(problem, surface=surface), poses)
    assert filled.faces.shape[0] > world.character.faces.shape[0]
    np.testing.assert_allclose(terms_again, terms, rtol=1e-5)
    np.testing.assert_allclose(again, totals, rtol=1e-5)


def test_searches_of_like_characters_have_the_same_shapes(world):
    """Two meshes whose faces and limbs differ in number, as two persons' do."""
    surface = world.problem(FRAME).surface
    other, nearest = simplify(world.character, world.character.faces.shape[0] - 60)
    coarser = simplified_surface(surface, np.asarray(other.faces), nearest)
    shapes = []
    for character, tables in ((world.character, surface), (other, coarser)):
        meshes = [None, *(simplified_mesh(character, tables, share) for share in (0.25, 0.5))]
        groups = [group_searches(filled_up(character), search_energy(), mesh=mesh) for mesh in meshes]
        drawn = [(group.character, group.part, group.surface) for alike in groups for group in alike]
        shapes.append(jax.tree.map(lambda leaf: (leaf.shape, leaf.dtype), drawn))
    assert other.faces.shape != world.character.faces.shape
    assert jax.tree.structure(shapes[0]) == jax.tree.structure(shapes[1])
    assert shapes[0] == shapes[1]
