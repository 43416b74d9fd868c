"""Eq. 5 of whole poses."""

import jax.numpy as jnp
import numpy as np

from jaxmocap._cache import optimised_jit
from jaxmocap.character import Character, Pose, difference
from jaxmocap.energies import Region, SearchEnergy, body_part, prepare_base, score_particles
from jaxmocap.observation import FrameProblem


@optimised_jit
def _score(energy, character, part, pose, problem, increments, capacity):
    height, width = problem.size
    region = Region(jnp.zeros((problem.num_cameras, 2), jnp.int32), (height, width))
    base = prepare_base(energy, character, part, pose, problem, region, capacity)
    return score_particles(energy, character, part, pose, problem, region, base, increments, capacity)


class PoseScore:
    """Scores some poses on the full problem; the windows' capacity grows when needed (host)."""

    def __init__(self, energy: SearchEnergy, character: Character):
        self.energy = energy
        self.character = character
        self.part = body_part(character, character.skeleton.group("root"))
        self.capacity = 2 ** (character.faces.shape[0] - 1).bit_length()

    def __call__(self, problem: FrameProblem, poses: list[Pose]) -> tuple[np.ndarray, np.ndarray]:
        """Totals (pose,) and terms (pose, term)."""
        moved = [np.asarray(difference(self.character.skeleton, poses[0], pose)) for pose in poses]
        increments = jnp.asarray(np.stack(moved + moved[-1:] * (-len(poses) % 4)))  # few and many compile once
        while True:
            scores = _score(self.energy, self.character, self.part, poses[0], problem, increments, self.capacity)
            needed = int(scores.needed)
            if needed <= self.capacity:
                return np.asarray(scores.total)[: len(poses)], np.asarray(scores.terms)[: len(poses)]
            self.capacity = 2 ** (needed - 1).bit_length()
