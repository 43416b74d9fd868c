"""What moves each face."""

import numpy as np
from jaxtyping import Int

from ._character import Character


def dominant_bodies(character: Character) -> Int[np.ndarray, "face"]:
    """The body that moves each face most."""
    return np.asarray(character.weights)[np.asarray(character.faces)].sum(1).argmax(1)
