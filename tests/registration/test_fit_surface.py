"""The surface of a generic body moves to the outlines of a person whose surface is known."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmocap.capture import Capture
from jaxmocap.character import skin
from jaxmocap.geometry import vertex_normals
from jaxmocap.registration import fit_surface
from jaxmocap.registration._fit_surface import _lines, _normal_equations
from jaxmocap.registration._shape_outlines import mask_problems
from jaxmocap.synthetic import make_capture, write_capture

FRAMES = (0, 1, 2)
THINNER = -0.015  # metres


@pytest.fixture(scope="module")
def filmed():
    return make_capture(len(FRAMES), (480, 270), 3, fps=1.0, selected_frames=FRAMES)


@pytest.fixture(scope="module")
def generic(filmed):
    """The person filmed, but for a trunk and thighs that are thinner."""
    character = filmed.character
    bodies = [character.skeleton.body_names.index(n) for n in ("pelvis", "abdomen", "chest", "l_thigh", "r_thigh")]
    share = np.asarray(character.weights)[:, bodies].sum(1)
    normals = vertex_normals(np.asarray(character.vertices, float), np.asarray(character.faces))
    moved = character.vertices + jnp.asarray(THINNER * share[:, None] * normals, jnp.float32)
    return eqx.tree_at(lambda one: one.vertices, character, moved), share


@pytest.fixture(scope="module")
def seen(filmed, generic, tmp_path_factory):
    capture = Capture.open(write_capture(filmed, tmp_path_factory.mktemp("surface") / "capture"))
    poses = {frame: filmed.pose(frame) for frame in FRAMES}
    masks = [list(filmed.masks[frame]) for frame in FRAMES]
    return poses, mask_problems(capture, capture.cameras, generic[0], poses, masks)


@pytest.fixture(scope="module")
def fitted(seen, generic):
    return fit_surface(generic[0], *seen)


@pytest.mark.slow
def test_most_of_what_is_missing_is_put_back_and_what_was_right_stays(fitted, generic):
    _, share = generic
    assert np.median(fitted.offsets[share > 0.9]) == pytest.approx(-THINNER, abs=0.4 * -THINNER)
    assert abs(np.median(fitted.offsets[share < 0.1])) < 0.1 * -THINNER


@pytest.mark.slow
def test_both_sides_move_alike_and_the_skeleton_stays(fitted, generic):
    character, share = generic
    left = np.asarray(character.vertices)[:, 0] > 0
    sides = [np.mean(fitted.offsets[(share > 0.9) & side]) for side in (left, ~left)]
    assert sides[0] == pytest.approx(sides[1], abs=0.002)
    assert eqx.tree_equal(fitted.character.skeleton, character.skeleton)
    distance = np.linalg.norm(np.asarray(fitted.character.vertices - character.vertices), axis=1)
    np.testing.assert_allclose(distance, np.abs(fitted.offsets), atol=1e-6)


@pytest.mark.slow
def test_poses_stay_where_they_were_right(fitted, seen, filmed):
    for frame, pose in fitted.poses.items():
        moved = skin(filmed.character, pose) - skin(filmed.character, seen[0][frame])
        assert np.median(np.linalg.norm(np.asarray(moved), axis=1)) < 0.005


def test_the_slope_of_the_outlines_is_that_of_finite_differences(seen, generic):
    """Normals that turn with the bodies stand for those of the posed surface, which bends where bodies meet."""
    character, pose, problem = generic[0], seen[0][1], seen[1][1]
    lines = _lines(character, pose, problem, 25)
    normals = jnp.asarray(
        vertex_normals(np.asarray(character.vertices, float), np.asarray(character.faces)), jnp.float32
    )

    def cost(offsets):
        moved = eqx.tree_at(lambda one: one.vertices, character, character.vertices + offsets[:, None] * normals)
        error = jnp.sum(lines.residual(skin(moved, pose)) ** 2, axis=-1)
        return 0.5 * jnp.sum(lines.weight / (1 / error + 1 / 0.03**2)) / 0.02**2

    _, downhill = _normal_equations(character, pose, lines)
    still = jnp.zeros(len(character.vertices))
    for seed in range(3):
        along = jax.random.normal(jax.random.key(seed), still.shape)
        along = along + 3.0 * jnp.asarray(downhill, jnp.float32) / np.abs(downhill).max()
        slope = (cost(still + 2e-3 * along) - cost(still - 2e-3 * along)) / 4e-3
        assert -np.dot(downhill, np.asarray(along)) == pytest.approx(float(slope), rel=0.05)
