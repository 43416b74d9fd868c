"""A character with fewer faces is the same body."""

import jax.numpy as jnp
import numpy as np
import pytest
import trimesh

from jaxmocap.character import simplify, skin
from jaxmocap.metrics import nearest_on_surface
from jaxmocap.metrics._surface import surface_points
from jaxmocap.synthetic import make_capture


@pytest.fixture(scope="module")
def truth():
    return make_capture(2, (160, 120))


@pytest.mark.parametrize("share", [0.5, 0.25])
def test_a_posed_simplified_body_lies_on_the_posed_body(truth, share):
    character = truth.character
    wanted = round(share * character.faces.shape[0])
    simple, nearest = simplify(character, wanted)
    assert abs(simple.faces.shape[0] - wanted) <= 2
    np.testing.assert_allclose(np.asarray(simple.weights).sum(1), 1, atol=1e-5)
    pose = truth.pose(1)
    posed = [np.asarray(skin(c, pose), np.float64) for c in (character, simple)]
    face, barycentric = nearest_on_surface(posed[1], posed[0], np.asarray(character.faces))
    on_surface = surface_points(posed[0][np.asarray(character.faces)[face]], barycentric)
    gaps = np.linalg.norm(on_surface - posed[1], axis=1)
    assert np.percentile(gaps, 99) < 0.02
    assert np.mean(gaps) < 0.004
    volumes = [trimesh.Trimesh(v, np.asarray(c.faces)).volume for v, c in zip(posed, (character, simple), strict=True)]
    assert volumes[1] == pytest.approx(volumes[0], rel=0.05)
    assert volumes[1] > 0
    assert nearest.shape == (character.faces.shape[0],)
    centres = [v[np.asarray(c.faces)].mean(1) for v, c in zip(posed, (character, simple), strict=True)]
    assert np.percentile(np.linalg.norm(centres[0] - centres[1][nearest], axis=1), 95) < 0.06


def test_a_mesh_that_is_small_enough_is_left_alone(truth):
    character = truth.character
    simple, nearest = simplify(character, character.faces.shape[0])
    assert simple is character
    np.testing.assert_array_equal(nearest, jnp.arange(character.faces.shape[0]))
