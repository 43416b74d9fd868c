"""A character with other proportions."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmocap.character import (
    GIRTHS,
    LENGTHS,
    BodyShape,
    Character,
    bone_lengths,
    landmark_positions,
    pose_from_vector,
    scaled,
    skin,
)
from jaxmocap.synthetic import make_actor

SHAPE = BodyShape.of(
    0.05,
    {"torso": 0.04, "shoulders": 0.06, "hips": -0.05, "upper_arm": -0.08, "thigh": 0.1, "foot": 0.1},
    {"torso": 0.1, "thigh": -0.1, "hand": 0.2},
)


@pytest.fixture(scope="module")
def person() -> Character:
    return make_actor()


def leaves(character: Character) -> list[np.ndarray]:
    return [np.asarray(leaf) for leaf in jax.tree.leaves(eqx.filter(character, eqx.is_array))]


def test_the_zero_shape_changes_no_bit(person):
    for before, after in zip(leaves(person), leaves(scaled(person, BodyShape.of())), strict=True):
        np.testing.assert_array_equal(before, after)


def test_bones_have_the_lengths_the_shape_says(person):
    before, after = (bone_lengths(c.skeleton) for c in (person, scaled(person, SHAPE)))
    for name in before:
        expected = 0.05 + float(SHAPE.lengths[LENGTHS.index(name)])
        assert float(jnp.log(after[name] / before[name])) == pytest.approx(
            expected, abs=2e-3 if name == "torso" else 1e-5
        )


def test_height_alone_scales_everything_about_the_floor(person):
    taller = scaled(person, BodyShape.of(np.log(1.1)))
    heel = float(person.skeleton.landmark("l_heel")[1])
    shift = np.asarray(taller.vertices) - 1.1 * np.asarray(person.vertices)
    np.testing.assert_allclose(shift, np.broadcast_to(shift[0], shift.shape), atol=1e-5)
    assert float(taller.skeleton.landmark("l_heel")[1]) == pytest.approx(heel, abs=1e-5)


def test_girth_widens_a_thigh_across_its_bone_and_not_along(person):
    wide = scaled(person, BodyShape.of(girths={"thigh": 0.2}))
    skeleton = person.skeleton
    hip, knee = (np.asarray(skeleton.landmark(f"l_{name}")) for name in ("hip", "knee"))
    along = (knee - hip) / np.linalg.norm(knee - hip)
    own = np.asarray(person.weights)[:, skeleton.body_names.index("l_thigh")] > 0.999
    assert own.sum() > 10

    def split(character: Character) -> tuple[np.ndarray, np.ndarray]:
        points = np.asarray(character.vertices)[own] - np.asarray(character.skeleton.landmark("l_hip"))
        return points @ along, np.linalg.norm(points - (points @ along)[:, None] * along, axis=1)

    (far, thick), (far_after, thick_after) = split(person), split(wide)
    np.testing.assert_allclose(far_after, far, atol=1e-5)
    np.testing.assert_allclose(thick_after, np.exp(0.2) * thick, rtol=1e-3)


def test_both_sides_stay_alike(person):
    skeleton = scaled(person, SHAPE).skeleton
    for name in skeleton.landmark_names:
        if name.startswith("l_") and f"r_{name[2:]}" in skeleton.landmark_names:
            before = [np.asarray(person.skeleton.landmark(side + name[2:])) for side in ("l_", "r_")]
            after = [np.asarray(skeleton.landmark(side + name[2:])) for side in ("l_", "r_")]
            uneven = np.abs(before[0] - before[1] * [-1, 1, 1]).max()
            np.testing.assert_allclose(after[0], after[1] * [-1, 1, 1], atol=1.3 * uneven + 1e-5)


def test_a_posed_body_hangs_together(person):
    """Joints of posed limbs are as long as at rest, whichever way they are computed."""
    character = scaled(person, SHAPE)
    skeleton = character.skeleton
    vector = 0.3 * jnp.asarray(np.random.default_rng(0).standard_normal(39), jnp.float32)
    at = dict(
        zip(skeleton.landmark_names, landmark_positions(skeleton, pose_from_vector(skeleton, vector)), strict=True)
    )
    for a, b in (("l_shoulder", "l_elbow"), ("r_hip", "r_knee"), ("l_knee", "l_ankle")):
        rest = jnp.linalg.norm(skeleton.landmark(a) - skeleton.landmark(b))
        assert float(jnp.linalg.norm(at[a] - at[b])) == pytest.approx(float(rest), abs=1e-5)


def test_axes_limits_weights_and_triangles_are_kept(person):
    character = scaled(person, SHAPE)
    for name in ("axes", "lower", "upper"):
        np.testing.assert_array_equal(getattr(character.skeleton, name), getattr(person.skeleton, name))
    np.testing.assert_array_equal(character.weights, person.weights)
    np.testing.assert_array_equal(character.faces, person.faces)


def test_a_saved_file_is_read_back_the_same(person, tmp_path):
    character = scaled(person, SHAPE)
    again = Character.load(character.save_glb(tmp_path / "scaled.glb"))
    np.testing.assert_allclose(again.vertices, character.vertices, atol=1e-6)
    np.testing.assert_allclose(again.weights, character.weights, atol=1e-6)
    for name in ("axes", "origins", "lower", "upper", "landmarks"):
        np.testing.assert_allclose(getattr(again.skeleton, name), getattr(character.skeleton, name), atol=1e-5)


def test_the_gradient_is_that_of_finite_differences(person):
    pose = pose_from_vector(person.skeleton, jnp.full(39, 0.2))
    probe = jnp.asarray(np.random.default_rng(1).standard_normal((len(person.vertices), 3)), jnp.float32)

    def value(numbers):
        shape = BodyShape(numbers[0], numbers[1 : 1 + len(LENGTHS)], numbers[1 + len(LENGTHS) :])
        character = scaled(person, shape)
        points = landmark_positions(character.skeleton, pose)
        return jnp.sum(probe * skin(character, pose)) / 50 + jnp.sum(points * points)

    start = jnp.concatenate([SHAPE.height[None], SHAPE.lengths, SHAPE.girths])
    slope = jax.jit(jax.grad(value))(start)
    step = 2e-2
    for index in range(len(start)):
        ahead, behind = (float(value(start.at[index].add(sign * step))) for sign in (1, -1))
        assert float(slope[index]) == pytest.approx((ahead - behind) / (2 * step), rel=1e-2, abs=5e-3)


def test_many_shapes_at_once(person):
    shapes = BodyShape(jnp.array([0.0, 0.1]), jnp.zeros((2, len(LENGTHS))), jnp.zeros((2, len(GIRTHS))))
    several = jax.vmap(scaled, in_axes=(None, 0))(person, shapes)
    np.testing.assert_array_equal(several.vertices[0], person.vertices)
    one = scaled(person, BodyShape.of(0.1))
    np.testing.assert_allclose(several.vertices[1], one.vertices, atol=1e-6)
