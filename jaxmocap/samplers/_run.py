"""Drivers: score what a sampler asks for, tell it, repeat."""

from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from ._base import AbstractSampler, AbstractState, StepInfo, finite_or_inf

EnergyFunction = Callable[[Float[Array, "particle dof"]], Any]
Stages = EnergyFunction | Sequence[tuple[EnergyFunction, int]]


class SearchInfo(eqx.Module):
    """How a search went. `steps` has a row per evaluated set: one more than the iterations for `"best_if_better"`."""

    energy: Float[Array, ""]  # of the returned particle; NaN for the answer "mean", which is not evaluated
    mean: Float[Array, "dof"]
    mean_energy: Float[Array, ""]  # NaN for the answer "mean"
    deviation: Float[Array, "dof"]  # of the particles that formed the mean
    best: Float[Array, "dof"]  # lowest energy seen in the last stage
    best_energy: Float[Array, ""]
    steps: StepInfo


class _Progress(eqx.Module):
    state: AbstractState
    best: Float[Array, "dof"]
    best_energy: Float[Array, ""]


class _Row(eqx.Module):
    step: StepInfo
    mean: Float[Array, "dof"]  # the estimate and deviation before this set was told
    deviation: Float[Array, "dof"]
    first_energy: Float[Array, ""]


@eqx.filter_jit
def _propose(
    sampler: AbstractSampler, progress: _Progress, key: PRNGKeyArray, iteration: Int[Array, ""], check: Bool[Array, ""]
) -> Float[Array, "particle dof"]:
    particles = sampler.ask(progress.state, jax.random.fold_in(key, 2 * iteration + 1))
    mean, _ = sampler.result(progress.state)
    return particles.at[0].set(jnp.where(check, mean, particles[0]))


@eqx.filter_jit
def _learn(
    sampler: AbstractSampler,
    progress: _Progress,
    particles: Float[Array, "particle dof"],
    energies: Float[Array, "particle"],
    key: PRNGKeyArray,
    iteration: Int[Array, ""],
) -> tuple[_Progress, _Row]:
    energies = finite_or_inf(energies).astype(particles.dtype)
    mean, deviation = sampler.result(progress.state)
    state, step = sampler.tell(progress.state, particles, energies, jax.random.fold_in(key, 2 * iteration + 2))
    winner = jnp.argmin(energies)
    better = energies[winner] < progress.best_energy
    best = jnp.where(better, particles[winner], progress.best)
    after = _Progress(state, best, jnp.minimum(energies[winner], progress.best_energy))
    return after, _Row(step, mean, deviation, energies[0])


def _begin(
    sampler: AbstractSampler,
    start: Float[Array, "dof"],
    spread: Float[Array, "dof"],
    lower: Float[Array, "dof"],
    upper: Float[Array, "dof"],
    key: PRNGKeyArray,
    population: Float[Array, "extra dof"] | None,
) -> _Progress:
    state = sampler.init(jax.random.fold_in(key, 0), start, spread, lower, upper, population)
    return _Progress(state, jnp.clip(start, lower, upper), jnp.full((), jnp.inf, start.dtype))


def _finish(sampler: AbstractSampler, progress: _Progress, rows: list[_Row]) -> tuple[Float[Array, "dof"], SearchInfo]:
    joined = jax.tree.map(lambda *parts: jnp.concatenate(parts), *rows)
    if sampler.answer == "mean":
        mean, deviation = sampler.result(progress.state)
        energy = mean_energy = jnp.full_like(progress.best_energy, jnp.nan)
        answer = mean
    else:
        mean, deviation, mean_energy = joined.mean[-1], joined.deviation[-1], joined.first_energy[-1]
        answer, energy = progress.best, progress.best_energy
    return answer, SearchInfo(energy, mean, mean_energy, deviation, progress.best, progress.best_energy, joined.step)


def _plan(sampler: AbstractSampler, energy_fn: Stages) -> list[tuple[EnergyFunction, int, bool]]:
    """(energy, number of sets, whether the last set holds the mean for checking) per stage."""
    stages = [(energy_fn, sampler.num_iterations)] if callable(energy_fn) else list(energy_fn)
    check = sampler.answer != "mean"
    last = len(stages) - 1
    return [(energy, count + (check and i == last), check and i == last) for i, (energy, count) in enumerate(stages)]


@eqx.filter_jit
def run(
    sampler: AbstractSampler,
    energy_fn: Stages,
    start: Float[Array, "dof"],
    spread: Float[Array, "dof"],
    lower: Float[Array, "dof"],
    upper: Float[Array, "dof"],
    key: PRNGKeyArray,
    population: Float[Array, "extra dof"] | None = None,
) -> tuple[Float[Array, "dof"], SearchInfo]:
    """Minimise `energy_fn` (particles (N, d) -> energies (N,)) over the box, in one compiled loop.

    `energy_fn` may instead be a sequence of `(energy_fn, iterations)` stages, coarse to fine: the particles pass from
    one stage to the next, but energies of different stages are never compared, so the best particle is that of the last
    stage. Give an `eqx.Module` or a `jax.tree_util.Partial` as energy, so that new data does not compile again; a plain
    closure compiles once per function object. `population` holds extra initial particles, for a warm start.

    With the answer `"best_if_better"` one set more than `num_iterations` is evaluated: its particle 0 is the estimate.
    """
    progress = _begin(sampler, start, spread, lower, upper, key, population)
    rows, done = [], 0
    for energy, count, check in _plan(sampler, energy_fn):

        def step(progress: _Progress, iteration: Int[Array, ""], energy=energy, last=done + count - 1, check=check):
            particles = _propose(sampler, progress, key, iteration, jnp.asarray(check) & (iteration == last))
            return _learn(sampler, progress, particles, energy(particles), key, iteration)

        progress = eqx.tree_at(lambda p: p.best_energy, progress, jnp.full_like(progress.best_energy, jnp.inf))
        progress, stage_rows = jax.lax.scan(step, progress, jnp.arange(done, done + count))
        rows.append(stage_rows)
        done += count
    return _finish(sampler, progress, rows)


def run_stepwise(
    sampler: AbstractSampler,
    energy_fn: Stages,
    start: Float[Array, "dof"],
    spread: Float[Array, "dof"],
    lower: Float[Array, "dof"],
    upper: Float[Array, "dof"],
    key: PRNGKeyArray,
    population: Float[Array, "extra dof"] | None = None,
) -> tuple[Float[Array, "dof"], SearchInfo]:
    """`run` as a Python loop, for energies computed on the host; `energy_fn` may return any array of shape (N,)."""
    progress = _begin(sampler, start, spread, lower, upper, key, population)
    rows, iteration = [], 0
    for energy, count, check in _plan(sampler, energy_fn):
        progress = eqx.tree_at(lambda p: p.best_energy, progress, jnp.full_like(progress.best_energy, jnp.inf))
        for index in range(count):
            number, is_check = jnp.asarray(iteration), jnp.asarray(check and index == count - 1)
            particles = _propose(sampler, progress, key, number, is_check)
            progress, row = _learn(sampler, progress, particles, jnp.asarray(energy(particles)), key, number)
            rows.append(jax.tree.map(lambda leaf: leaf[None], row))
            iteration += 1
    return _finish(sampler, progress, rows)
