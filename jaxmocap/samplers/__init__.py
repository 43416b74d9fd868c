"""Global search by proposing and being told: interacting simulated annealing and alternatives. Arrays only."""

from ._annealing import Schedule as Schedule
from ._base import (
    AbstractSampler as AbstractSampler,
    AbstractState as AbstractState,
    Answer as Answer,
    Proposal as Proposal,
    StepInfo as StepInfo,
    finite_or_inf as finite_or_inf,
    first_proposal as first_proposal,
    particles_for as particles_for,
    step_info as step_info,
)
from ._cross_entropy import CrossEntropy as CrossEntropy
from ._isa import InteractingSimulatedAnnealing as InteractingSimulatedAnnealing
from ._limits import reflect as reflect
from ._random_search import RandomSearch as RandomSearch
from ._resampling import (
    effective_sample_size as effective_sample_size,
    multinomial as multinomial,
    systematic as systematic,
)
from ._run import SearchInfo as SearchInfo, run as run, run_stepwise as run_stepwise
