"""The loop of a search: score what a sampler asks for, tell it, repeat."""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from jaxmocap._shapes import check_key, check_shape

from ._base import AbstractSampler, AbstractState, StepInfo, finite_or_inf

EnergyFunction = Callable[[Float[Array, "particle dof"]], Any]


class SearchInfo(eqx.Module):
    """How a search went. `steps` has a row per evaluated set: one more than the iterations for `"best_if_better"`."""

    energy: Float[Array, ""]  # of the returned particle; NaN for the answer "mean", which is not evaluated
    mean: Float[Array, "dof"]
    mean_energy: Float[Array, ""]  # NaN for the answer "mean"
    deviation: Float[Array, "dof"]  # of the particles that formed the mean
    best: Float[Array, "dof"]  # lowest energy seen
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


class Pool(NamedTuple):
    """Candidates for the first set, of which the `keep` with the lowest energies are taken."""

    candidates: Float[Array, "candidate dof"]
    keep: int


def _propose(
    sampler: AbstractSampler, progress: _Progress, key: PRNGKeyArray, check: Bool[Array, ""]
) -> Float[Array, "particle dof"]:
    particles = sampler.ask(progress.state, key)
    mean, _ = sampler.result(progress.state)
    return particles.at[0].set(jnp.where(check, mean, particles[0]))


def _learn(
    sampler: AbstractSampler,
    progress: _Progress,
    particles: Float[Array, "particle dof"],
    energies: Float[Array, "particle"],
    key: PRNGKeyArray,
) -> tuple[_Progress, _Row]:
    energies = finite_or_inf(energies).astype(particles.dtype)
    mean, deviation = sampler.result(progress.state)
    state, step = sampler.tell(progress.state, particles, energies, key)
    winner = jnp.argmin(energies)
    better = energies[winner] < progress.best_energy
    best = jnp.where(better, particles[winner], progress.best)
    after = _Progress(state, best, jnp.minimum(energies[winner], progress.best_energy))
    return after, _Row(step, mean, deviation, energies[0])


def _finish(sampler: AbstractSampler, progress: _Progress, rows: _Row) -> tuple[Float[Array, "dof"], SearchInfo]:
    if sampler.answer == "mean":
        mean, deviation = sampler.result(progress.state)
        energy = mean_energy = jnp.full_like(progress.best_energy, jnp.nan)
        answer = mean
    else:
        mean, deviation, mean_energy = rows.mean[-1], rows.deviation[-1], rows.first_energy[-1]
        answer, energy = progress.best, progress.best_energy
    return answer, SearchInfo(energy, mean, mean_energy, deviation, progress.best, progress.best_energy, rows.step)


class _Scouts(eqx.Module):
    """The candidates of a pool, N at a time, the last set filled up; the energies of those that were scored; how many
    there are, and how many are kept."""

    candidates: Float[Array, "set particle dof"]
    energies: Float[Array, "set particle"]
    count: int = eqx.field(static=True)
    keep: int = eqx.field(static=True)

    @staticmethod
    def make(pool: Pool, num_particles: int) -> "_Scouts":
        count = pool.candidates.shape[0]
        sets = -(-count // num_particles)
        filled = jnp.pad(pool.candidates, ((0, sets * num_particles - count), (0, 0)), mode="edge")
        split = filled.reshape(sets, num_particles, -1)
        return _Scouts(split, jnp.full(split.shape[:2], jnp.inf, split.dtype), count, pool.keep)

    @property
    def sets(self) -> int:
        return self.candidates.shape[0]

    def told(self, number: Int[Array, ""], energies: Float[Array, "particle"]) -> "_Scouts":
        """Store the energies of a set; a set that is none of its own changes nothing."""
        energies = finite_or_inf(energies).astype(self.energies.dtype)
        return eqx.tree_at(lambda own: own.energies, self, self.energies.at[number].set(energies, mode="drop"))

    def best(self, population: Float[Array, "extra dof"] | None) -> Float[Array, "extra_and_kept dof"]:
        """Join the population and the candidates of lowest energy."""
        every = self.candidates.reshape(-1, self.candidates.shape[-1])
        kept = every[jax.lax.top_k(-self.energies.reshape(-1)[: self.count], self.keep)[1]]
        return kept if population is None else jnp.concatenate([population, kept])


def _checked(energy_fn: EnergyFunction, num_particles: int) -> EnergyFunction:
    def energies_of(particles: Float[Array, "particle dof"]) -> Array:
        energies = energy_fn(particles)
        check_shape("what the energy returns", energies, (num_particles,), "one number per particle")
        return energies

    return energies_of


@eqx.filter_jit
def run(
    sampler: AbstractSampler,
    energy_fn: EnergyFunction,
    start: Float[Array, "dof"],
    spread: Float[Array, "dof"],
    lower: Float[Array, "dof"],
    upper: Float[Array, "dof"],
    key: PRNGKeyArray,
    population: Float[Array, "extra dof"] | None = None,
    pool: Pool | None = None,
) -> tuple[Float[Array, "dof"], SearchInfo]:
    """Minimise `energy_fn` (particles (N, d) -> energies (N,)) over the box, in one compiled loop.

    The box is from `lower` to `upper`, where infinity is no limit, and the first particles are drawn about `start` with
    the standard deviations `spread`, in the units of the energy's argument. Returns the answer (d,) and how the search
    went.

    Give an `eqx.Module` or a `jax.tree_util.Partial` as energy, so that new data does not compile again; a plain
    closure compiles once per function object, and energies computed on the host go through `jax.pure_callback`.
    `population` holds extra initial particles, for a warm start; the best of a `pool` are such particles too.

    With the answer `"best_if_better"` one set more than `num_iterations` is evaluated: its particle 0 is the estimate.
    Raises `InputError` for bounds or energies of another shape, and for what is no key.
    """
    check_key(key)
    check_shape("start", start, ("dof",))
    for name, values in (("spread", spread), ("lower", lower), ("upper", upper)):
        check_shape(name, values, np.shape(start), "one number per dimension of the start")
    energy_fn = _checked(energy_fn, sampler.num_particles)
    scouts = None if pool is None else _Scouts.make(pool, sampler.num_particles)
    before = 0 if scouts is None else scouts.sets
    steps = sampler.num_iterations + (sampler.answer != "mean")
    sets = before + steps

    def key_of(number: int | Int[Array, ""]) -> PRNGKeyArray:
        """Derive a key by number.

        0 begins; 2n + 1 and 2n + 2 are asked with and told with in step n; 2 `sets` + 1 begins with no pool yet.
        """
        return jax.random.fold_in(key, number)

    def begin(extra: Float[Array, "extra dof"] | None, number: int) -> _Progress:
        state = sampler.init(key_of(number), start, spread, lower, upper, extra)
        return _Progress(state, jnp.clip(start, lower, upper), jnp.full((), jnp.inf, start.dtype))

    progress = begin(population, 0 if scouts is None else 2 * sets + 1)

    def step(
        carry: tuple[_Progress, _Scouts | None], iteration: Int[Array, ""]
    ) -> tuple[tuple[_Progress, _Scouts | None], _Row]:
        progress, scouts = carry
        number = iteration if scouts is None else iteration % sets  # steps before 0 come last
        asked, told = key_of(2 * number + 1), key_of(2 * number + 2)
        check = jnp.asarray(sampler.answer != "mean") & (iteration == steps - 1)
        particles = _propose(sampler, progress, asked, check)
        if scouts is None:
            after, row = _learn(sampler, progress, particles, energy_fn(particles), told)
            return (after, None), row
        # The pool is scored by this very loop, in the steps before 0: the energy, which is large, compiles once.
        scouting, turn = iteration < 0, iteration + scouts.sets
        particles = jnp.where(scouting, scouts.candidates[jnp.minimum(turn, scouts.sets - 1)], particles)
        energies = energy_fn(particles)
        after, row = _learn(sampler, progress, particles, energies, told)
        scouts = scouts.told(turn, energies)
        begun = jax.lax.cond(iteration == -1, lambda: begin(scouts.best(population), 0), lambda: progress)
        return (jax.tree.map(lambda a, b: jnp.where(scouting, a, b), begun, after), scouts), row

    (progress, _), rows = jax.lax.scan(step, (progress, scouts), jnp.arange(-before, steps))
    return _finish(sampler, progress, jax.tree.map(lambda leaf: leaf[before:], rows))
