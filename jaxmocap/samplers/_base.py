"""What every sampler is: it proposes particles, is told their energies, and names an answer."""

import abc
from dataclasses import fields, replace
from typing import Literal, Self

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from jaxmocap._results import InputError

Answer = Literal["mean", "best_if_better"]
"""What `run` returns of a sampler, see `AbstractSampler`."""


def particles_for(num_dofs: int) -> int:
    """Return `2^n + 40` particles for a group of n degrees of freedom (Sec. 4.1; 104 for 6, 168 for 7)."""
    return 2**num_dofs + 40


def reflect(
    particles: Float[Array, "*batch dof"], lower: Float[Array, "dof"], upper: Float[Array, "dof"]
) -> Float[Array, "*batch dof"]:
    """Fold values back at the limits, as often as needed. Clipping would collect particles on the wall.

    Infinite limits are allowed on either side; equal limits pin the value.
    """
    two_sided = jnp.isfinite(lower) & jnp.isfinite(upper)
    width = jnp.where(two_sided, upper - lower, 1.0)
    safe_width = jnp.where(width > 0, width, 1.0)
    low = jnp.where(jnp.isfinite(lower), lower, 0.0)
    high = jnp.where(jnp.isfinite(upper), upper, 0.0)
    phase = jnp.mod(particles - low, 2 * safe_width)
    folded = low + jnp.where(phase > safe_width, 2 * safe_width - phase, phase)
    above = jnp.where(jnp.isfinite(lower), low + jnp.abs(particles - low), particles)
    one_sided = jnp.where(jnp.isfinite(upper), high - jnp.abs(high - particles), above)
    inside = (particles >= lower) & (particles <= upper)
    return jnp.clip(jnp.where(inside, particles, jnp.where(two_sided, folded, one_sided)), lower, upper)


def effective_sample_size(weights: Float[Array, "particle"]) -> Float[Array, ""]:
    """Compute `(sum w)^2 / sum w^2`: how many equally weighted particles the set is worth."""
    return jnp.sum(weights) ** 2 / jnp.sum(weights**2)


class Proposal(eqx.Module):
    """Where the next particles come from: `centres + jitter * noise @ factor.T`, folded back at the limits."""

    centres: Float[Array, "particle dof"]
    factor: Float[Array, "dof dof"]
    jitter: Float[Array, "particle"]
    lower: Float[Array, "dof"]
    upper: Float[Array, "dof"]

    def draw(self, key: PRNGKeyArray) -> Float[Array, "particle dof"]:
        noise = jax.random.normal(key, self.centres.shape, self.centres.dtype)
        moved = self.centres + self.jitter[:, None] * jnp.matmul(noise, self.factor.T, precision="highest")
        return reflect(moved, self.lower, self.upper)

    def around(self, centres: Float[Array, "particle dof"], factor: Float[Array, "dof dof"]) -> "Proposal":
        """Keep the limits, take new centres; every particle is moved."""
        return Proposal(centres, factor, jnp.ones_like(self.jitter), self.lower, self.upper)


class StepInfo(eqx.Module):
    """What one evaluated set looked like. After `run`, every field has a leading iteration axis."""

    best_energy: Float[Array, "*iteration"]  # lowest energy of this set, +inf if none was finite
    effective_sample_size: Float[Array, "*iteration"]
    beta: Float[Array, "*iteration"]  # inverse temperature; +inf for samplers that only rank
    spread: Float[Array, "*iteration dof"]  # standard deviation of this set, unweighted


class AbstractState(eqx.Module):
    """What the next step needs. A sampler adds its own fields."""

    proposal: eqx.AbstractVar[Proposal]


class AbstractSampler(eqx.Module):
    """Minimise an energy over a box by proposing particles (`ask`) and being told their energies (`tell`).

    Samplers know arrays only. The caller scores: see `run`. `answer` says what `run` returns: `"mean"` is the sampler's
    own estimate, never evaluated (the paper's weighted average); `"best_if_better"` evaluates that estimate in one
    further set and returns the particle with the lowest energy ever seen.
    """

    num_particles: eqx.AbstractVar[int]
    num_iterations: eqx.AbstractVar[int]
    answer: eqx.AbstractVar[Answer]

    def sized(self, num_particles: int, num_iterations: int, sigma_min: Float[Array, "dof"]) -> Self:
        """Give this sampler another budget and, where it has one, another floor of the deviation."""
        sizes = {"num_particles": num_particles, "num_iterations": num_iterations, "sigma_min": sigma_min}
        own = {field.name for field in fields(self)}
        return replace(self, **{name: value for name, value in sizes.items() if name in own})

    @abc.abstractmethod
    def init(
        self,
        key: PRNGKeyArray,
        start: Float[Array, "dof"],
        spread: Float[Array, "dof"],
        lower: Float[Array, "dof"],
        upper: Float[Array, "dof"],
        population: Float[Array, "extra dof"] | None = None,
    ) -> AbstractState:
        """Make the first state.

        Particle 0 is `start`, the following ones are `population` (a warm start), the rest are drawn around `start`
        with standard deviation `spread`. A dimension of zero spread stays where it is.
        """

    def ask(self, state: AbstractState, key: PRNGKeyArray) -> Float[Array, "particle dof"]:
        """Return the particles to evaluate next, inside the limits."""
        return state.proposal.draw(key)

    @abc.abstractmethod
    def tell(
        self,
        state: AbstractState,
        particles: Float[Array, "particle dof"],
        energies: Float[Array, "particle"],
        key: PRNGKeyArray,
    ) -> tuple[AbstractState, StepInfo]:
        """Learn from the energies of `particles`. Energies that are not finite count as +inf."""

    @abc.abstractmethod
    def result(self, state: AbstractState) -> tuple[Float[Array, "dof"], Float[Array, "dof"]]:
        """Return the estimate after the last `tell`, and the standard deviation of the particles that formed it."""


def first_proposal(
    num_particles: int,
    start: Float[Array, "dof"],
    spread: Float[Array, "dof"],
    lower: Float[Array, "dof"],
    upper: Float[Array, "dof"],
    population: Float[Array, "extra dof"] | None,
) -> Proposal:
    """Make the set of `AbstractSampler.init`: start and warm-start population as they are, the rest jittered."""
    if num_particles < 1:
        raise InputError(f"the sampler has {num_particles} particles; at least 1 is needed.")
    start = jnp.clip(start, lower, upper)
    kept = start[None] if population is None else jnp.concatenate([start[None], population.astype(start.dtype)])
    if kept.shape[0] > num_particles:
        raise InputError(
            f"The warm start has {kept.shape[0] - 1} particles, but the sampler has {num_particles} "
            "including the start; give fewer or raise num_particles."
        )
    rest = jnp.broadcast_to(start, (num_particles - kept.shape[0], start.shape[0]))
    jitter = jnp.ones(num_particles, start.dtype).at[: kept.shape[0]].set(0.0)
    return Proposal(jnp.concatenate([kept, rest]), jnp.diag(spread.astype(start.dtype)), jitter, lower, upper)


def finite_or_inf(energies: Float[Array, "particle"]) -> Float[Array, "particle"]:
    """Count everything that is not a finite number among the energies as +inf."""
    return jnp.where(jnp.isfinite(energies), energies, jnp.inf)


def step_info(
    particles: Float[Array, "particle dof"],
    energies: Float[Array, "particle"],
    weights: Float[Array, "particle"],
    beta: float | Float[Array, ""],
) -> StepInfo:
    """Record one evaluated set."""
    return StepInfo(
        best_energy=jnp.min(energies).astype(particles.dtype),
        effective_sample_size=effective_sample_size(weights),
        beta=jnp.asarray(beta, particles.dtype),
        spread=jnp.std(particles, axis=0),
    )


def weighted_mean_and_deviation(
    particles: Float[Array, "particle dof"], weights: Float[Array, "particle"]
) -> tuple[Float[Array, "dof"], Float[Array, "dof"]]:
    """Average the particles by weight; return that with their standard deviation."""
    share = weights / jnp.sum(weights)
    mean = jnp.einsum("p,pd->d", share, particles, precision="highest")
    variance = jnp.einsum("p,pd->d", share, (particles - mean) ** 2, precision="highest")
    return mean, jnp.sqrt(variance)
