"""Many searches of one group of degrees of freedom in one compiled call: every setting with every seed."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Key, PRNGKeyArray

from jaxmocap._results import InputError
from jaxmocap._shapes import check_shape
from jaxmocap.character import Character, Pose
from jaxmocap.energies import GroupProblem, SearchEnergy, body_part, part_windows, prepare_base, score_particles
from jaxmocap.observation import FrameProblem
from jaxmocap.render import Driver, best_driver
from jaxmocap.samplers import AbstractSampler, run
from jaxmocap.search import ROOT_REACH
from jaxmocap.track import with_settings


class BatchedSearch(NamedTuple):
    """`increments (setting, seed, dof)` of the pose and their `energies (setting, seed)`, each by its own setting."""

    increments: Float[Array, "setting seed dof"]
    energies: Float[Array, "setting seed"]


class _Particles(eqx.Module):
    """The energy of increments of one group, for a sampler."""

    search: "SearchBatch"
    energy: SearchEnergy
    base: Any

    def __call__(self, values: Float[Array, "particle group_dof"]) -> Float[Array, "particle"]:
        search, group = self.search, self.search.group
        still = jnp.zeros((values.shape[0], group.character.skeleton.num_dofs))
        increments = still.at[:, jnp.array(search.dofs)].set(values)
        scores = score_particles(self.energy, group, self.base, increments, search.capacity, search.driver)
        return jnp.where(scores.needed > search.capacity, jnp.nan, scores.total)


class SearchBatch(eqx.Module):
    """Searches of one group around a pose in one frame. `make` prepares it; calling it runs all of them in one compiled
    call, and `one` runs a single one, for a loop in Python with the same answers.

    With the driver "scatter", that of accelerators, all run at once under `jax.vmap`; with "loop", that of CPUs, one
    after the other, for there `vmap` takes three times as long as a loop."""

    energy: SearchEnergy
    sampler: AbstractSampler
    group: GroupProblem
    spread: Float[Array, "group_dof"]
    lower: Float[Array, "group_dof"]
    upper: Float[Array, "group_dof"]
    dofs: tuple[int, ...] = eqx.field(static=True)
    capacity: int = eqx.field(static=True)
    driver: Driver | None = eqx.field(static=True, default=None)

    @staticmethod
    def make(
        energy: SearchEnergy,
        sampler: AbstractSampler,
        character: Character,
        pose: Pose,
        problem: FrameProblem,
        group: str,
        *,
        step: int = 4,
        driver: Driver | None = None,
    ) -> "SearchBatch":
        """Set up a search around `pose` over the degrees of freedom of `group` ("root", "l_arm", ...).

        It sees every `step`-th pixel of the frame's rectangle. `driver` is how particles are drawn, by default the
        machine's best. Raises `InputError` for an unknown group.
        """
        skeleton = character.skeleton
        dofs = skeleton.group(group)
        part = body_part(character, dofs)
        whole = GroupProblem(character, part, pose, problem.coarser(step))
        reach = jnp.array(ROOT_REACH)
        lower = jnp.concatenate([-reach, skeleton.lower - pose.angles])[jnp.array(dofs)]
        upper = jnp.concatenate([reach, skeleton.upper - pose.angles])[jnp.array(dofs)]
        spread = jnp.asarray(skeleton.initial_spread[np.array(dofs)], jnp.float32)
        capacity = 2 ** int(np.ceil(np.log2(2 * part.faces.shape[1])))
        posed = part.posed(character, pose)
        cameras = range(whole.frame.num_cameras)
        needed = [part_windows(whole, posed, jnp.asarray(camera), capacity)[0].needed for camera in cameras]
        capacity = max(capacity, 2 ** int(np.ceil(np.log2(2 * max(int(n) for n in needed) + 1))))
        return SearchBatch(energy, sampler, whole, spread, lower, upper, dofs, capacity, driver)

    def one(self, energy: SearchEnergy, key: PRNGKeyArray) -> tuple[Float[Array, "dof"], Float[Array, ""]]:
        """Search once with this energy and key; return the increment found and its energy."""
        return _one(self, energy, key)

    def __call__(self, settings: Mapping[str, Float[Array, "setting"]], seeds: Int[Array, "seed"]) -> BatchedSearch:
        """Search with all settings and all seeds.

        `settings` are array leaves of the energy by their dotted names, as long as each other:
        `{"terms.view_view.weight": jnp.array([0.0, 0.3, 1.0])}`. Raises `InputError` for other settings, and for seeds
        that are no whole numbers.
        """
        check_shape("seeds", seeds, ("seed",), "whole numbers such as jnp.arange(8)")
        energies, axes = self.batched(settings)
        keys = jax.vmap(jax.random.key)(jnp.asarray(seeds))
        increments, values = _every(self, energies, axes, keys)
        return BatchedSearch(increments, values)

    def batched(self, settings: Mapping[str, Float[Array, "setting"]]) -> tuple[SearchEnergy, Any]:
        """Give every varied leaf of the energy a leading axis; say which leaves have one, as `vmap` wants it.

        Raises `InputError` if settings differ in length or are not numbers that can be swept.
        """
        lengths = {name: np.shape(values) for name, values in settings.items()}
        if not lengths or len(set(lengths.values())) > 1 or any(len(shape) != 1 for shape in lengths.values()):
            raise InputError(f"settings to be batched need one array each, all of one length; got {lengths}.")
        energies = with_settings(self.energy, settings)
        axes = jax.tree.map(lambda new, old: 0 if new.ndim > old.ndim else None, energies, self.energy)
        return energies, axes


@eqx.filter_jit
def _one(batch: SearchBatch, energy: SearchEnergy, key: PRNGKeyArray) -> tuple[Float[Array, "dof"], Float[Array, ""]]:
    b = batch
    base = prepare_base(energy, b.group, 2 ** (len(b.group.character.faces) - 1).bit_length())
    start = jnp.zeros(len(b.dofs))
    best, info = run(b.sampler, _Particles(b, energy, base), start, b.spread, b.lower, b.upper, key)
    return jnp.zeros(b.group.character.skeleton.num_dofs).at[jnp.array(b.dofs)].set(best), info.energy


@eqx.filter_jit
def _every(
    batch: SearchBatch, energies: SearchEnergy, axes: Any, keys: Key[Array, "seed"]
) -> tuple[Float[Array, "setting seed dof"], Float[Array, "setting seed"]]:
    if (batch.driver or best_driver()) == "scatter":
        over_seeds = jax.vmap(lambda energy, key: _one(batch, energy, key), in_axes=(None, 0))
        return jax.vmap(over_seeds, in_axes=(axes, None))(energies, keys)

    def pair(number: Array) -> tuple[Array, Array]:
        here, seed = number // len(keys), number % len(keys)
        energy = _entry(energies, axes, here)
        return _one(batch, energy, keys[seed])

    count = max(len(leaf) for leaf, axis in _leaves(energies, axes) if axis == 0)
    increments, values = jax.lax.map(pair, jnp.arange(count * len(keys)))
    return increments.reshape(count, len(keys), -1), values.reshape(count, len(keys))


def _leaves(energies: SearchEnergy, axes: Any) -> list[tuple[Array, int | None]]:
    marks = jax.tree.leaves(axes, is_leaf=lambda leaf: leaf is None)
    return list(zip(jax.tree.leaves(energies), marks, strict=True))


def _entry(energies: SearchEnergy, axes: Any, number: Array) -> SearchEnergy:
    """One of the batched energies."""
    leaves = [leaf if axis is None else leaf[number] for leaf, axis in _leaves(energies, axes)]
    return jax.tree.unflatten(jax.tree.structure(energies), leaves)
