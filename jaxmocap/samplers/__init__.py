"""Global search by proposing and being told: interacting simulated annealing and alternatives. Arrays only."""

from ._annealing import Schedule as Schedule, multinomial as multinomial, systematic as systematic
from ._base import (
    AbstractSampler as AbstractSampler,
    AbstractState as AbstractState,
    Answer as Answer,
    Proposal as Proposal,
    StepInfo as StepInfo,
    effective_sample_size as effective_sample_size,
    finite_or_inf as finite_or_inf,
    first_proposal as first_proposal,
    particles_for as particles_for,
    reflect as reflect,
    step_info as step_info,
)
from ._cross_entropy import CrossEntropy as CrossEntropy
from ._isa import InteractingSimulatedAnnealing as InteractingSimulatedAnnealing
from ._random_search import RandomSearch as RandomSearch
from ._run import Pool as Pool, SearchInfo as SearchInfo, run as run
