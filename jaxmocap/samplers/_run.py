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


class _Pool(eqx.Module):
    """Candidates for the first set, N at a time, the last set filled up; the energies of those that were scored; how
    many there are, and how many are kept."""

    candidates: Float[Array, "set particle dof"]
    energies: Float[Array, "set particle"]
    count: int = eqx.field(static=True)
    keep: int = eqx.field(static=True)

    @staticmethod
    def make(candidates: Float[Array, "candidate dof"], keep: int, num_particles: int) -> "_Pool":
        sets = -(-candidates.shape[0] // num_particles)
        filled = jnp.pad(candidates, ((0, sets * num_particles - candidates.shape[0]), (0, 0)), mode="edge")
        split = filled.reshape(sets, num_particles, -1)
        return _Pool(split, jnp.full(split.shape[:2], jnp.inf, split.dtype), candidates.shape[0], keep)

    @property
    def sets(self) -> int:
        return self.candidates.shape[0]

    def told(self, number: Int[Array, ""], energies: Float[Array, "particle"]) -> "_Pool":
        """With the energies of a set; a set that is none of its own changes nothing."""
        energies = finite_or_inf(energies).astype(self.energies.dtype)
        return eqx.tree_at(lambda pool: pool.energies, self, self.energies.at[number].set(energies, mode="drop"))

    def best(self, population: Float[Array, "extra dof"] | None) -> Float[Array, "extra_and_kept dof"]:
        """The population and the candidates of lowest energy."""
        every = self.candidates.reshape(-1, self.candidates.shape[-1])
        kept = every[jax.lax.top_k(-self.energies.reshape(-1)[: self.count], self.keep)[1]]
        return kept if population is None else jnp.concatenate([population, kept])


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
    pool: Float[Array, "candidate dof"] | None = None,
    keep: int = 0,
) -> tuple[Float[Array, "dof"], SearchInfo]:
    """Minimise `energy_fn` (particles (N, d) -> energies (N,)) over the box, in one compiled loop.

    `energy_fn` may instead be a sequence of `(energy_fn, iterations)` stages, coarse to fine: the particles pass from
    one stage to the next, but energies of different stages are never compared, so the best particle is that of the last
    stage. Give an `eqx.Module` or a `jax.tree_util.Partial` as energy, so that new data does not compile again; a plain
    closure compiles once per function object. `population` holds extra initial particles, for a warm start; the `keep`
    best of a `pool`, by the energy of the first stage, are such particles too.

    With the answer `"best_if_better"` one set more than `num_iterations` is evaluated: its particle 0 is the estimate.
    """
    begin = lambda extra: _begin(sampler, start, spread, lower, upper, key, extra)  # noqa: E731
    progress = begin(population)
    candidates = None if pool is None else _Pool.make(pool, keep, sampler.num_particles)
    rows, done = [], 0
    for energy, count, check in _plan(sampler, energy_fn):
        first = candidates if done == 0 else None

        def step(carry, iteration: Int[Array, ""], energy=energy, last=done + count - 1, check=check):
            progress, pool = carry
            particles = _propose(sampler, progress, key, iteration, jnp.asarray(check) & (iteration == last))
            if pool is None:
                after, row = _learn(sampler, progress, particles, energy(particles), key, iteration)
                return (after, None), row
            # The pool is scored by this very loop, in the steps before 0: the energy, which is large, compiles once.
            scouting, turn = iteration < 0, iteration + pool.sets
            particles = jnp.where(scouting, pool.candidates[jnp.minimum(turn, pool.sets - 1)], particles)
            energies = energy(particles)
            after, row = _learn(sampler, progress, particles, energies, key, iteration)
            pool = pool.told(turn, energies)
            begun = jax.lax.cond(iteration == -1, lambda: begin(pool.best(population)), lambda: progress)
            return (jax.tree.map(lambda a, b: jnp.where(scouting, a, b), begun, after), pool), row

        progress = eqx.tree_at(lambda p: p.best_energy, progress, jnp.full_like(progress.best_energy, jnp.inf))
        before = 0 if first is None else first.sets
        (progress, _), stage_rows = jax.lax.scan(step, (progress, first), jnp.arange(done - before, done + count))
        rows.append(jax.tree.map(lambda leaf, before=before: leaf[before:], stage_rows))
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
    pool: Float[Array, "candidate dof"] | None = None,
    keep: int = 0,
) -> tuple[Float[Array, "dof"], SearchInfo]:
    """`run` as a Python loop, for energies computed on the host; `energy_fn` may return any array of shape (N,)."""
    plan = _plan(sampler, energy_fn)
    if pool is not None:
        candidates = _Pool.make(pool, keep, sampler.num_particles)
        for turn, particles in enumerate(candidates.candidates):
            candidates = candidates.told(jnp.asarray(turn), jnp.asarray(plan[0][0](particles)))
        population = candidates.best(population)
    progress = _begin(sampler, start, spread, lower, upper, key, population)
    rows, iteration = [], 0
    for energy, count, check in plan:
        progress = eqx.tree_at(lambda p: p.best_energy, progress, jnp.full_like(progress.best_energy, jnp.inf))
        for index in range(count):
            number, is_check = jnp.asarray(iteration), jnp.asarray(check and index == count - 1)
            particles = _propose(sampler, progress, key, number, is_check)
            progress, row = _learn(sampler, progress, particles, jnp.asarray(energy(particles)), key, number)
            rows.append(jax.tree.map(lambda leaf: leaf[None], row))
            iteration += 1
    return _finish(sampler, progress, rows)
