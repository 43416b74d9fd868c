"""Random search: the shortest sampler, and the pattern to copy for a new one."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from jaxmocap._types import Knob, knob

from ._base import AbstractSampler, AbstractState, Answer, Proposal, StepInfo, finite_or_inf, first_proposal, step_info


class RandomSearchState(AbstractState):
    """State of `RandomSearch`."""

    proposal: Proposal
    best: Float[Array, "dof"]
    best_energy: Float[Array, ""]


class RandomSearch(AbstractSampler):
    """Gaussian draws around the best particle so far.

    Attributes:
        num_particles: 168, that of seven degrees of freedom (`particles_for`).
        num_iterations: 25, as of the annealing.
        answer: "best_if_better", or "mean".
        shrink: what each iteration multiplies the deviation by; 0.85.
    """

    num_particles: int = eqx.field(static=True, default=168)
    num_iterations: int = eqx.field(static=True, default=25)
    answer: Answer = eqx.field(static=True, default="best_if_better")
    shrink: Knob = knob(0.85)

    def init(
        self,
        key: PRNGKeyArray,
        start: Float[Array, "dof"],
        spread: Float[Array, "dof"],
        lower: Float[Array, "dof"],
        upper: Float[Array, "dof"],
        population: Float[Array, "extra dof"] | None = None,
    ) -> RandomSearchState:
        proposal = first_proposal(self.num_particles, start, spread, lower, upper, population)
        return RandomSearchState(proposal, proposal.centres[0], jnp.full((), jnp.inf, proposal.centres.dtype))

    def tell(
        self,
        state: RandomSearchState,
        particles: Float[Array, "particle dof"],
        energies: Float[Array, "particle"],
        key: PRNGKeyArray,
    ) -> tuple[RandomSearchState, StepInfo]:
        energies = finite_or_inf(energies).astype(particles.dtype)
        winner = jnp.argmin(energies)
        better = energies[winner] < state.best_energy
        best = jnp.where(better, particles[winner], state.best)
        factor = (self.shrink * state.proposal.factor).astype(particles.dtype)
        proposal = state.proposal.around(jnp.broadcast_to(best, particles.shape), factor)
        weights = jnp.zeros_like(energies).at[winner].set(1.0)
        after = RandomSearchState(proposal, best, jnp.minimum(energies[winner], state.best_energy))
        return after, step_info(particles, energies, weights, jnp.inf)

    def result(self, state: RandomSearchState) -> tuple[Float[Array, "dof"], Float[Array, "dof"]]:
        return state.best, jnp.diag(state.proposal.factor)
