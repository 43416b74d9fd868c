"""Poses beside the truth, and how far they are from it."""

import jax.numpy as jnp
import numpy as np

from jaxmocap.character import clamp, retract, skin

LIMBS = ("shoulder_flex", "shoulder_abd", "elbow", "hip_flex", "hip_abd", "knee")


def perturbed(world, frame, degrees, seed=0, kind="joints", metres=0.0):
    """The true pose with `degrees` added or taken away: at the root, at all joints, or at the large joints of limbs."""
    rng = np.random.default_rng(seed)
    names = world.character.skeleton.dof_names
    wanted = {
        "root": lambda i, name: 3 <= i < 6,
        "joints": lambda i, name: i >= 6,
        "limbs": lambda i, name: any(part in name for part in LIMBS),
    }[kind]
    delta = np.array([wanted(i, name) for i, name in enumerate(names)]) * rng.choice([-1, 1], 39) * np.deg2rad(degrees)
    delta[:3] = metres * rng.choice([-1, 1], 3)
    skeleton = world.character.skeleton
    return clamp(skeleton, retract(skeleton, world.pose(frame), jnp.asarray(delta, jnp.float32)))


def moved(world, frame, **amounts):
    """The true pose with degrees of freedom changed, metres and degrees, as far as the joint limits allow."""
    skeleton = world.character.skeleton
    delta = np.zeros(39, np.float32)
    for name, amount in amounts.items():
        delta[skeleton.dof_names.index(name)] = amount if "root_t" in name else np.deg2rad(amount)
    return clamp(skeleton, retract(skeleton, world.pose(frame), jnp.asarray(delta)))


def arm_away(world, frame):
    """The true pose, but for a left arm that is 70 degrees off at the shoulder."""
    return moved(world, frame, l_shoulder_abd=-70, l_shoulder_flex=30)


def vertex_errors(world, frame, pose):
    """Metres, per vertex."""
    return np.linalg.norm(np.asarray(skin(world.character, pose)) - world.vertices(frame), axis=1)
