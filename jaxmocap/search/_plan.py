"""How much effort the search of sec. 4.1 makes."""

from dataclasses import dataclass
from typing import Literal

import jax
import numpy as np

from jaxmocap._results import InputError
from jaxmocap.samplers import AbstractSampler, particles_for

from ._gating import Gating, Retry


@dataclass(frozen=True)
class SearchPlan:
    """Set the effort of the search, whichever the sampler.

    Attributes:
        step: every `step`-th pixel, along rows and columns, is looked at: 1 (the paper), 2 or 4.
        iterations: sets of particles, one after the other; 25 is the paper.
        faces: share of the mesh's faces that a particle is drawn with; 1 is the paper.
        particles: per group; None is 2^n + 40 for n degrees of freedom (the paper).
        spread: factor of the first particles' deviation; 1.
        wide: share of a limb's first particles that look further afield; 0 is the paper.
        trunk: factor of particles and spread of root and torso, which are large and move less than limbs; 1 is the
            paper.
        gating: when a group need not be searched; None is never (the paper).
        retry: when a limb is searched again; None is never (the paper).
        relocalise: wider searches of root and torso after a frame whose verdict is "lost"; 0 is the paper.
        prior: what a particle pays for leaving the start in a degree of freedom, half of it at one deviation and never
            more than all (Geman and McClure 1985): where the pictures leave a direction open, as depth when the views
            are close together, it stays where flow and prediction put it; 0 is the paper, which has no motion prior
            here.
        groups: "hierarchy" is the paper's; "whole" searches all degrees of freedom at once, and then needs `particles`.
    """

    step: int = 1
    iterations: int = 25
    faces: float = 1.0
    particles: int | None = None
    spread: float = 1.0
    wide: float = 0.0
    trunk: float = 1.0
    gating: Gating | None = None
    retry: Retry | None = None
    relocalise: int = 0
    prior: float = 0.0
    groups: Literal["hierarchy", "whole"] = "hierarchy"

    def __post_init__(self) -> None:
        if self.step not in (1, 2, 4):
            raise InputError(f"a search looks at every pixel, every second or every fourth (1, 2, 4), not {self.step}.")
        if self.groups == "whole" and self.particles is None:
            raise InputError(
                "a search of the whole body at once needs a number of particles: 2^n of n DoFs are too many."
            )

    def count(self, num_dofs: int, share: float = 1.0) -> int:
        """Count the particles of a group."""
        return round(share * (particles_for(num_dofs) if self.particles is None else self.particles))

    def sized(
        self, sampler: AbstractSampler, dofs: tuple[int, ...], share: float = 1.0, width: int = 0
    ) -> AbstractSampler:
        """Size the sampler for one group.

        It gets the iterations, its particles (a share of them), and the smallest deviation: 2 mm for translations, 0.25
        degrees for angles. A search that is `width` wide has idle dimensions after the group's.
        """
        idle = max(width - len(dofs), 0)
        floor = jax.device_put(np.array([0.002 if dof < 3 else 0.00436 for dof in dofs] + [0.00436] * idle, np.float32))
        return sampler.sized(self.count(len(dofs), share), self.iterations, floor)
