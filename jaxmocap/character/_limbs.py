"""What moves each face, and the older names of what the skeleton says itself."""

import numpy as np
from jaxtyping import Bool, Float, Int

from ._character import Character


def dominant_bodies(character: Character) -> Int[np.ndarray, "face"]:
    """The body that moves each face most."""
    return np.asarray(character.weights)[np.asarray(character.faces)].sum(1).argmax(1)


def group_bodies(character: Character, dofs: tuple[int, ...]) -> Bool[np.ndarray, "body"]:
    """See `Skeleton.bodies_moved_by`."""
    return character.skeleton.bodies_moved_by(dofs)


def outer_halves(character: Character) -> list[Bool[np.ndarray, "body"]]:
    """See `Skeleton.distal_bodies`."""
    return character.skeleton.distal_bodies


def initial_spread(character: Character) -> Float[np.ndarray, "dof"]:
    """See `Skeleton.initial_spread`."""
    return character.skeleton.initial_spread
