"""The tracker's own energy under other optimisers: what the annealing and the hierarchy are worth."""

from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from jaxmocap._results import InputError
from jaxmocap._types import Knob, Quality, knob
from jaxmocap.character import human_table, is_limb
from jaxmocap.refinement import DetectionPlan
from jaxmocap.samplers import (
    AbstractSampler,
    AbstractState,
    Answer,
    InteractingSimulatedAnnealing,
    Proposal,
    StepInfo,
    reflect,
)
from jaxmocap.search import SearchPlan
from jaxmocap.track import Tracker


def local_only(quality: Quality = "normal") -> Tracker:
    """Make a tracker that optimises locally only (Fig. 12): optical flow and the refinement of sec. 4.2, no search."""
    return replace(Tracker.preset(quality), search=None, prediction=False)


def with_keypoints(quality: Quality = "normal") -> Tracker:
    """Make a tracker for which a detector's keypoints count beside the pixels, as in `run`; it needs keypoints."""
    return replace(Tracker.preset(quality), detections=DetectionPlan())


def flow_only(quality: Quality = "normal") -> Tracker:
    """Make a tracker that follows optical flow from frame to frame, and nothing else.

    It is the part of Wu, Stoll, Valgaerts and Theobalt, On-set performance capture of multiple actors with a stereo
    camera, TOG 32(6), 2013, from which the paper's search starts: points of the last frame's surface are led on by the
    flow of every view. Nothing corrects what one frame adds to the error; where the last pose scores better by Eq. 5
    than the flow's it stays, and at selected frames the registered pose is taken up again in the same way.
    """
    return replace(local_only(quality), refine=None, clip=None)


def _whole(plan: SearchPlan) -> SearchPlan:
    """Plan a search of the whole body with as many particles as this plan has group by group.

    They are counted on the usual skeleton of a person.
    """
    groups = human_table().groups
    counts = [plan.count(len(dofs), 1.0 if is_limb(name) else plan.trunk) for name, dofs in groups]
    return SearchPlan(plan.step, plan.iterations, plan.faces, sum(counts), plan.spread, groups="whole")


def annealed_particle_filter(quality: Quality = "normal") -> Tracker:
    """Make an annealed particle filter on Eq. 5.

    All degrees of freedom are searched at once, from the last pose with process noise; the answer is the weighted mean.
    There is no optical flow and no refinement.

    Its layers are those of Deutscher and Reid, Articulated body motion capture by stochastic search, IJCV 61, 2005: all
    particles are drawn anew by their weights, whose sharpness keeps half of them, and diffused by the spread of those.
    Its budget is that of the preset's search. Between frames the particles are handed on as their mean, since after the
    last layer they lie much closer together than the process noise spreads them.
    """
    preset = Tracker.preset(quality)
    assert preset.search is not None
    layers = InteractingSimulatedAnnealing(epsilon="zero", survival=0.5, answer="mean")
    search = _whole(preset.search)
    return replace(preset, search=search, sampler=layers, refine=None, flow_start=False, prediction=False)


class CovarianceState(AbstractState):
    """State of `CovarianceMatrixAdaptation`; `inner` is evosax's, in units of the first spread around the start."""

    proposal: Proposal
    inner: Any
    start: Float[Array, "dof"]
    unit: Float[Array, "dof"]


class CovarianceMatrixAdaptation(AbstractSampler):
    """CMA-ES (Hansen, The CMA evolution strategy: a tutorial, 2016), the implementation of evosax behind `ask` and
    `tell`. Particles are folded back at the limits.

    Attributes:
        num_particles: 168, that of seven degrees of freedom (`particles_for`).
        num_iterations: 25, as of the annealing.
        answer: "best_if_better", or "mean".
        step: first step size in units of the spread; 0.6.
    """

    num_particles: int = eqx.field(static=True, default=168)
    num_iterations: int = eqx.field(static=True, default=25)
    answer: Answer = eqx.field(static=True, default="best_if_better")
    step: Knob = knob(0.6)

    def _strategy(self, num_dofs: int) -> tuple[Any, Any]:
        """Make the strategy of evosax and its parameters."""
        try:
            from evosax.algorithms import CMA_ES  # pyright: ignore[reportMissingImports]
        except ImportError:
            raise InputError(
                "CMA-ES needs evosax, which is not installed; run pip install 'jaxmocap[bench]', or leave it out."
            ) from None
        strategy = CMA_ES(population_size=self.num_particles, solution=jnp.zeros(num_dofs))
        return strategy, strategy.default_params.replace(std_init=self.step)

    def init(
        self,
        key: PRNGKeyArray,
        start: Float[Array, "dof"],
        spread: Float[Array, "dof"],
        lower: Float[Array, "dof"],
        upper: Float[Array, "dof"],
        population: Float[Array, "extra dof"] | None = None,
    ) -> CovarianceState:
        strategy, params = self._strategy(start.shape[0])
        inner = strategy.init(key, jnp.zeros_like(start), params)
        inner = jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.result_type(leaf)), inner)
        start = jnp.clip(start, lower, upper)
        still = jnp.zeros((self.num_particles,), start.dtype)
        centres = jnp.broadcast_to(start, (self.num_particles, start.shape[0]))
        proposal = Proposal(centres, jnp.diag(spread), still, lower, upper)
        return CovarianceState(proposal, inner, start, spread.astype(start.dtype))

    def ask(self, state: CovarianceState, key: PRNGKeyArray) -> Float[Array, "particle dof"]:
        strategy, params = self._strategy(state.start.shape[0])
        with jax.default_matmul_precision("highest"):  # evosax leaves it to JAX
            population, _ = strategy.ask(key, state.inner, params)
        return reflect(state.start + population * state.unit, state.proposal.lower, state.proposal.upper)

    def tell(
        self,
        state: CovarianceState,
        particles: Float[Array, "particle dof"],
        energies: Float[Array, "particle"],
        key: PRNGKeyArray,
    ) -> tuple[CovarianceState, StepInfo]:
        strategy, params = self._strategy(state.start.shape[0])
        energies = jnp.where(jnp.isfinite(energies), energies, jnp.inf)
        worst = jnp.max(jnp.where(jnp.isfinite(energies), energies, -jnp.inf), initial=0.0)
        fitness = jnp.where(jnp.isfinite(energies), energies, worst + 1.0).astype(particles.dtype)
        active = state.unit > 0
        population = jnp.where(active, (particles - state.start) / jnp.where(active, state.unit, 1.0), 0.0)
        ask_key, tell_key = jax.random.split(key)
        with jax.default_matmul_precision("highest"):
            _, decomposed = strategy.ask(ask_key, state.inner, params)  # eigenvectors this generation was drawn with
            inner, _ = strategy.tell(tell_key, population, fitness, decomposed, params)
        inner = jax.tree.map(lambda new, old: jnp.asarray(new, old.dtype), inner, state.inner)
        after = CovarianceState(state.proposal, inner, state.start, state.unit)
        info = StepInfo(
            best_energy=jnp.min(energies).astype(particles.dtype),
            effective_sample_size=jnp.asarray(self.num_particles / 2, particles.dtype),
            beta=jnp.asarray(jnp.inf, particles.dtype),
            spread=jnp.std(particles, axis=0),
        )
        return after, info

    def result(self, state: CovarianceState) -> tuple[Float[Array, "dof"], Float[Array, "dof"]]:
        inner = state.inner
        mean = reflect(state.start + inner.mean * state.unit, state.proposal.lower, state.proposal.upper)
        deviation = inner.std * jnp.sqrt(jnp.maximum(jnp.diagonal(inner.C), 0.0)) * state.unit
        return mean, deviation


def covariance_matrix_adaptation(quality: Quality = "normal") -> Tracker:
    """Make a tracker that runs CMA-ES on Eq. 5 over all degrees of freedom at once.

    It takes the place of the hierarchical annealing and has its budget; flow start and refinement are the tracker's.
    """
    preset = Tracker.preset(quality)
    assert preset.search is not None
    sampler = CovarianceMatrixAdaptation()
    sampler._strategy(1)  # says at once where evosax is missing
    return replace(preset, search=_whole(preset.search), sampler=sampler)
