"""How much effort the search of sec. 4.1 makes, and with which sampler."""

from dataclasses import dataclass
from typing import Literal, NamedTuple

import jax
import numpy as np
from jaxtyping import Array, Float

from jaxmocap._results import InputError
from jaxmocap.samplers import AbstractSampler, InteractingSimulatedAnnealing, particles_for

from ._gating import Gating, Retry


class Effort(NamedTuple):
    """Some iterations of the search that look at every `step`-th pixel and draw a mesh with this share of its faces."""

    step: int = 1
    iterations: int = 25
    faces: float = 1.0


@dataclass(frozen=True)
class SearchPlan:
    """Effort of the annealing: `stages` run from coarse to fine; `particles` per
    group (None: 2^n + 40, the paper); `spread` multiplies the first particles' deviation; `wide` is the share
    of a limb's first particles that look further afield (0 is the paper); `trunk` scales particles and spread of root
    and torso, which are large and move less than limbs; `gating` says when a group need not be searched, `retry` when a
    limb is searched again (None: never, the paper); after a frame whose verdict
    is "lost", root and torso are searched `relocalise` times further afield (0: never, the paper). `prior` is what a
    particle pays for leaving the start in a degree of freedom, half of it at one deviation and never more than all
    (Geman and McClure 1985): where the pictures leave a direction open, as depth when the views are close together, it
    stays where flow and prediction put it (0: the paper, which has no motion prior here). `answer` "mean" is the
    paper's. `groups` "whole" searches all degrees of freedom at once instead of the paper's hierarchy, and
    then needs `particles`."""

    stages: tuple[Effort, ...] = (Effort(),)
    particles: int | None = None
    spread: float = 1.0
    wide: float = 0.0
    trunk: float = 1.0
    gating: Gating | None = None
    retry: Retry | None = None
    relocalise: int = 0
    prior: float = 0.0
    answer: Literal["mean", "best_if_better"] = "best_if_better"
    groups: Literal["hierarchy", "whole"] = "hierarchy"

    def __post_init__(self) -> None:
        if self.groups == "whole" and self.particles is None:
            raise InputError(
                "a search of the whole body at once needs a number of particles: 2^n of n DoFs are too many."
            )

    @property
    def iterations(self) -> int:
        """Of all stages."""
        return sum(stage.iterations for stage in self.stages)

    def count(self, num_dofs: int, share: float = 1.0) -> int:
        """Particles of a group."""
        return round(share * (particles_for(num_dofs) if self.particles is None else self.particles))

    def sampler(self, num_dofs: int, sigma_min: Float[Array, "dof"], share: float = 1.0) -> AbstractSampler:
        """The annealing of one group, with a share of the particles."""
        return InteractingSimulatedAnnealing(
            num_particles=self.count(num_dofs, share),
            num_iterations=self.iterations,
            answer=self.answer,
            sigma_min=sigma_min,
        )


def sigma_floor(dofs: tuple[int, ...]) -> Float[Array, "group_dof"]:
    """Smallest spread the annealing keeps: 2 mm for translations, 0.25 degrees for angles."""
    return jax.device_put(np.array([0.002 if dof < 3 else 0.00436 for dof in dofs], np.float32))
