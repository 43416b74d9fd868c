"""Scores of poses by every term at once, so that the tests of all terms share two compiled programs."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from jaxmocap.character import Character, Pose
from jaxmocap.energies import (
    Base,
    BodyPart,
    GroupProblem,
    ModelView,
    Posture,
    Scores,
    SearchEnergy,
    Silhouette,
    ViewView,
    body_part,
    prepare_base,
    score_particles,
)
from jaxmocap.observation import FrameProblem
from jaxmocap.render import Driver

TERMS = ("model_view", "view_view", "coarse", "colour", "silhouette", "posture")
FRAME = 2  # not a selected one: its background models are warped
PARTICLES = 144
CAPACITY = 8192


def energy_of(world) -> SearchEnergy:
    """Eq. 6; Eq. 7 as printed, with every second pixel, and over agreeing pixels only; the silhouettes; the posture."""
    return SearchEnergy(
        (
            ModelView(),
            ViewView(),
            ViewView(step=2, sampling="nearest"),
            ViewView(fail="ignore", outside="ignore"),
            Silhouette(jnp.asarray(world.masks(FRAME), jnp.float32)),
            Posture(),
        )
    )


@eqx.filter_jit
def score_in(
    energy: SearchEnergy,
    character: Character,
    part: BodyPart,
    pose: Pose,
    problem: FrameProblem,
    increments: Array,
    driver: Driver | None = None,
    live: Array | None = None,
) -> tuple[Scores, Base]:
    group = GroupProblem(character, part, pose, problem)
    base = prepare_base(energy, group, CAPACITY)
    return score_particles(energy, group, base, increments, CAPACITY, driver, live), base


def score(world, increments, energy: SearchEnergy | None = None) -> dict[str, np.ndarray]:
    """Terms of increments of the true pose, the whole body drawn anew; what fills up the shape is not scored."""
    increments = np.asarray(increments, np.float32)
    assert len(increments) <= PARTICLES
    padded = np.zeros((PARTICLES, 39), np.float32)
    padded[: len(increments)] = increments
    live = jnp.arange(PARTICLES) < len(increments)
    character, problem = world.character, world.problem(FRAME)
    part = body_part(character, character.skeleton.group("root"))
    energy = energy_of(world) if energy is None else energy
    scores, _ = score_in(energy, character, part, world.pose(FRAME), problem, jnp.asarray(padded), None, live)
    assert int(scores.needed) <= CAPACITY
    terms = np.asarray(scores.terms)[: len(increments)]
    return dict(zip(TERMS, terms.T, strict=True)) | {"total": np.asarray(scores.total)[: len(increments)]}
