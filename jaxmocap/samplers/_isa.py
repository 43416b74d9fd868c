"""Interacting simulated annealing."""

from typing import Literal, get_args

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, PRNGKeyArray

from jaxmocap._results import InputError
from jaxmocap._types import Knob, knob

from ._annealing import (
    Schedule,
    beta_for_effective_sample_size,
    boltzmann_weights,
    energy_gaps,
    energy_scale,
    multinomial,
    systematic,
)
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

Epsilon = Literal["inverse_max", "zero"]
Resampling = Literal["multinomial", "systematic"]


class AnnealingState(AbstractState):
    """State of `InteractingSimulatedAnnealing`."""

    proposal: Proposal
    iteration: Int[Array, ""]
    beta: Float[Array, ""]
    scale: Float[Array, ""]  # standard deviation of the energies at iteration 0, for "poly_std"
    mean: Float[Array, "dof"]
    deviation: Float[Array, "dof"]
    active: Float[Array, "dof"]  # 1 where the spread was positive, 0 for dimensions that stay


class InteractingSimulatedAnnealing(AbstractSampler):
    """Sec. 4.1 of the paper: interacting simulated annealing (Gall, Potthoff, Schnoerr, Rosenhahn, Seidel, JMIV 28,
    2007).

    Each iteration weighs the particles by `exp(-beta V)`, keeps particle i with probability `epsilon * weight_i` and
    redraws the others in proportion to the weights, then moves all of them by Gaussian noise whose covariance is
    `alpha` times that of the selected set. The estimate is the weighted average of the last evaluated set, before any
    further move.

    Departures from the publication: the noise floor, mirrors at the limits instead of a truncated Gaussian, and a set
    of equal energies is moved by the floor only, so that a flat energy never inflates the cloud. On energies that are
    averages over pixels, in [0, 1], the published schedule with factor 1 gives all particles the same weight: nothing
    is selected and the cloud spreads. The paper names no schedule.

    Attributes:
        num_particles: 168, that of seven degrees of freedom (`particles_for`).
        num_iterations: 25, the paper's.
        answer: "best_if_better", or "mean", the paper's weighted average.
        schedule: "ess" chooses beta so that the effective sample size is `survival * num_particles`; "poly_std" is
            `(t + 1)^exponent` on energies divided by their standard deviation at iteration 0; "poly_raw" the published
            `beta_factor * (t + 1)^exponent`.
        epsilon: "inverse_max" keeps the best particle surely; "zero" redraws all (annealed particle filter).
        resampling: of the redrawn part, "multinomial" (as published) or "systematic".
        strict: never let beta decrease; False.
        survival: effective sample size, share of the particles; 0.3, ours.
        alpha: factor of the covariance that moves the particles; 0.4, as published.
        sigma_min: floor of the noise, scalar or one value per dimension, in the units of the dimension; 0.25 degrees,
            ours. Give an array with 0.002 for translations in metres.
        exponent: of the polynomial schedules; 0.7, as published.
        beta_factor: of "poly_raw"; 1.
    """

    num_particles: int = eqx.field(static=True, default=168)
    num_iterations: int = eqx.field(static=True, default=25)
    answer: Answer = eqx.field(static=True, default="best_if_better")
    schedule: Schedule = eqx.field(static=True, default="ess")
    epsilon: Epsilon = eqx.field(static=True, default="inverse_max")
    resampling: Resampling = eqx.field(static=True, default="multinomial")
    strict: bool = eqx.field(static=True, default=False)
    survival: Knob = knob(0.3)
    alpha: Knob = knob(0.4)
    sigma_min: Float[Array, "*dof"] = knob(0.00436)
    exponent: Knob = knob(0.7)
    beta_factor: Knob = knob(1.0)

    def __check_init__(self) -> None:
        options = {"answer": Answer, "schedule": Schedule, "epsilon": Epsilon, "resampling": Resampling}
        for name, kind in options.items():
            if getattr(self, name) not in get_args(kind):
                raise InputError(f"{name} is {getattr(self, name)!r}, expected one of {', '.join(get_args(kind))}.")

    def init(
        self,
        key: PRNGKeyArray,
        start: Float[Array, "dof"],
        spread: Float[Array, "dof"],
        lower: Float[Array, "dof"],
        upper: Float[Array, "dof"],
        population: Float[Array, "extra dof"] | None = None,
    ) -> AnnealingState:
        proposal = first_proposal(self.num_particles, start, spread, lower, upper, population)
        zero = jnp.zeros((), proposal.centres.dtype)
        active = (spread > 0).astype(proposal.centres.dtype)
        return AnnealingState(
            proposal, jnp.zeros((), jnp.int32), zero, zero + 1.0, proposal.centres[0], jnp.zeros_like(active), active
        )

    def tell(
        self,
        state: AnnealingState,
        particles: Float[Array, "particle dof"],
        energies: Float[Array, "particle"],
        key: PRNGKeyArray,
    ) -> tuple[AnnealingState, StepInfo]:
        energies = finite_or_inf(energies).astype(particles.dtype)
        gaps = energy_gaps(energies)
        scale = jnp.where(state.iteration == 0, energy_scale(gaps), state.scale)
        beta = self._beta(gaps, scale, state)
        weights = boltzmann_weights(gaps, beta)
        flat = jnp.max(jnp.where(jnp.isfinite(gaps), gaps, 0.0)) <= 0
        selected = self._select(key, particles, weights, flat)
        factor = self._noise_factor(selected, flat, state.active)
        mean, deviation = weighted_mean_and_deviation(particles, weights)
        proposal = state.proposal.around(selected, factor)
        after = AnnealingState(proposal, state.iteration + 1, beta, scale, mean, deviation, state.active)
        return after, step_info(particles, energies, weights, beta)

    def result(self, state: AnnealingState) -> tuple[Float[Array, "dof"], Float[Array, "dof"]]:
        return state.mean, state.deviation

    def _beta(self, gaps: Float[Array, "particle"], scale: Float[Array, ""], state: AnnealingState) -> Float[Array, ""]:
        if self.schedule == "ess":
            beta = beta_for_effective_sample_size(gaps, self.survival)
        else:
            beta = (state.iteration + 1.0) ** self.exponent
            beta = beta / scale if self.schedule == "poly_std" else beta * self.beta_factor
        beta = beta.astype(gaps.dtype)
        return jnp.maximum(beta, state.beta) if self.strict else beta

    def _select(
        self,
        key: PRNGKeyArray,
        particles: Float[Array, "particle dof"],
        weights: Float[Array, "particle"],
        flat: Array,
    ) -> Float[Array, "particle dof"]:
        """Select: keep with probability `epsilon * weight`, redraw the others. The largest weight is 1."""
        keep_key, draw_key = jax.random.split(key)
        if self.epsilon == "inverse_max":
            kept = (jax.random.uniform(keep_key, weights.shape, weights.dtype) <= weights) & (weights > 0)
        else:
            kept = flat & (weights > 0)
        redraw = systematic if self.resampling == "systematic" else multinomial
        return particles[redraw(draw_key, weights, ~kept)]

    def _noise_factor(
        self, selected: Float[Array, "particle dof"], flat: Array, active: Float[Array, "dof"]
    ) -> Float[Array, "dof dof"]:
        """Cholesky factor of `alpha * covariance + sigma_min^2`; zero rows where a dimension is not active."""
        centred = selected - jnp.mean(selected, axis=0)
        covariance = jnp.matmul(centred.T, centred, precision="highest") / max(self.num_particles - 1, 1)
        floor = jnp.where(active > 0, jnp.maximum(self.sigma_min, 1e-6), 1.0) ** 2
        noise = jnp.where(flat, 0.0, self.alpha) * covariance * active * active[:, None] + jnp.diag(floor)
        return (jnp.linalg.cholesky(noise) * active[:, None]).astype(selected.dtype)
