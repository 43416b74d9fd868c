"""The cross-entropy method."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from jaxmocap._types import Knob, knob

from ._base import (
    AbstractSampler,
    AbstractState,
    Answer,
    Proposal,
    StepInfo,
    finite_or_inf,
    first_proposal,
    step_info,
    weighted_mean_and_deviation,
)


class CrossEntropyState(AbstractState):
    """State of `CrossEntropy`."""

    proposal: Proposal
    mean: Float[Array, "dof"]
    deviation: Float[Array, "dof"]
    active: Float[Array, "dof"]


class CrossEntropy(AbstractSampler):
    """The cross-entropy method, Rubinstein, Methodology and Computing in Applied Probability 1, 1999.

    Draw from a Gaussian with independent dimensions, refit it to the best of the particles, repeat.

    Attributes:
        num_particles: 168, that of seven degrees of freedom (`particles_for`).
        num_iterations: 25, as of the annealing.
        elites: best share of the particles; 0.15.
        answer: "best_if_better", or "mean".
        smoothing: share of the old mean and deviation that is kept; 0.2.
        sigma_min: floor of the deviation, scalar or one value per dimension, in the units of the dimension; 0.25
            degrees.
    """

    num_particles: int = eqx.field(static=True, default=168)
    num_iterations: int = eqx.field(static=True, default=25)
    elites: float = eqx.field(static=True, default=0.15)
    answer: Answer = eqx.field(static=True, default="best_if_better")
    smoothing: Knob = knob(0.2)
    sigma_min: Float[Array, "*dof"] = knob(0.00436)

    def init(
        self,
        key: PRNGKeyArray,
        start: Float[Array, "dof"],
        spread: Float[Array, "dof"],
        lower: Float[Array, "dof"],
        upper: Float[Array, "dof"],
        population: Float[Array, "extra dof"] | None = None,
    ) -> CrossEntropyState:
        proposal = first_proposal(self.num_particles, start, spread, lower, upper, population)
        mean = proposal.centres[0]
        return CrossEntropyState(proposal, mean, spread.astype(mean.dtype), (spread > 0).astype(mean.dtype))

    def tell(
        self,
        state: CrossEntropyState,
        particles: Float[Array, "particle dof"],
        energies: Float[Array, "particle"],
        key: PRNGKeyArray,
    ) -> tuple[CrossEntropyState, StepInfo]:
        energies = finite_or_inf(energies)
        order = jnp.argsort(energies, stable=True)[: max(round(self.elites * self.num_particles), 1)]
        share = jnp.isfinite(energies[order]).astype(particles.dtype)
        share = jnp.where(jnp.any(share > 0), share, 1.0)
        elite_mean, elite_deviation = weighted_mean_and_deviation(particles[order], share)
        blend = jnp.where(jnp.any(jnp.isfinite(energies)), self.smoothing, 1.0)
        mean = (blend * state.mean + (1 - blend) * elite_mean).astype(particles.dtype)
        deviation = blend * state.deviation + (1 - blend) * elite_deviation
        deviation = (state.active * jnp.maximum(deviation, self.sigma_min)).astype(particles.dtype)
        proposal = state.proposal.around(jnp.broadcast_to(mean, particles.shape), jnp.diag(deviation))
        weights = jnp.zeros_like(particles[:, 0]).at[order].set(share)
        return CrossEntropyState(proposal, mean, deviation, state.active), step_info(
            particles, energies, weights, jnp.inf
        )

    def result(self, state: CrossEntropyState) -> tuple[Float[Array, "dof"], Float[Array, "dof"]]:
        return state.mean, state.deviation
