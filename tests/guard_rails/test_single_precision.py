"""What single precision costs, against the same in double precision. The bounds are those of docs/sharp_bits.md."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxmocap.camera import project
from jaxmocap.character import Pose, landmark_positions, retract, skin
from jaxmocap.refiners import RefineProblem, Shooting
from jaxmocap.synthetic import make_actor

ACTOR = make_actor()
RNG = np.random.default_rng(0)
LIMITS = np.asarray(ACTOR.skeleton.lower), np.asarray(ACTOR.skeleton.upper)
ANGLES = RNG.uniform(*LIMITS, (8, 33))
ROOTS = np.tile(np.eye(4), (8, 1, 1))
ROOTS[:, :3, 3] = RNG.uniform(-5, 5, (8, 3))  # metres from the world's origin
INTRINSICS = np.array([[1500.0, 0, 960], [0, 1500, 540], [0, 0, 1]])
FACING = np.array([[1.0, 0, 0, 0], [0, -1, 0, 1], [0, 0, -1, 9], [0, 0, 0, 1]])


def both(function, *arguments) -> float:
    """The largest difference between the two precisions."""
    single = function(*(jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float32), part) for part in arguments))
    single = np.asarray(single, np.float64)
    with jax.enable_x64(True):
        double = function(*(jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float64), part) for part in arguments))
        assert double.dtype == jnp.float64
        return float(np.abs(single - np.asarray(double)).max())


def precise(character):
    """The character with its numbers in the precision at hand."""
    return jax.tree.map(lambda x: jnp.asarray(np.asarray(x), float) if x.dtype.kind == "f" else x, character)


def test_skinning_is_right_to_five_micrometres_five_metres_from_the_origin():
    for root, angles in zip(ROOTS, ANGLES, strict=True):
        off = both(lambda pose: skin(precise(ACTOR), pose), Pose(root, angles))
        assert off < 5e-6


def test_projection_is_right_to_two_thousandths_of_a_pixel_in_full_high_definition():
    points = np.asarray(ACTOR.vertices, float) + ROOTS[:, None, :3, 3] * [1, 0.2, 1]
    assert both(lambda *given: project(*given)[0], INTRINSICS, FACING, points.reshape(-1, 3)) < 2e-3


def test_a_refinement_finds_the_same_pose_to_a_tenth_of_a_milliradian():
    """Landmarks pulled to those of a pose nearby; the L1 term and the prior as in tracking."""
    away = RNG.normal(0, 0.05, 39)

    def found(root, angles, away):
        skeleton = precise(ACTOR).skeleton
        pose = Pose(root, angles)
        target = landmark_positions(skeleton, retract(skeleton, pose, away))
        places = lambda delta: landmark_positions(skeleton, retract(skeleton, pose, delta))  # noqa: E731
        residual = lambda delta: 1000 * (places(delta) - target).reshape(-1)  # noqa: E731
        zero = jnp.zeros_like(away)
        return Shooting().refine(RefineProblem(residual, zero, zero - 1, zero + 1), zero).value

    assert both(jax.jit(found), ROOTS[0], 0.5 * ANGLES[0], away) < 1e-4
