"""Eq. 5 and its relatives: a weighted sum of terms, scored for a whole generation of particles in one compiled call."""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from jaxmocap._results import InputError
from jaxmocap._shapes import check_shape
from jaxmocap.character import Pose, retract
from jaxmocap.render import (
    Driver,
    best_driver,
    dirty_tiles,
    draw,
    put_back,
    touched_rows,
)

from ._body import GroupProblem, base_buffers, part_windows, pixels_outside
from ._model_view import ModelView
from ._pose_terms import Posture
from ._term import AbstractTerm, Drawn
from ._view_view import ViewView


class SearchEnergy(eqx.Module):
    """A weighted sum of terms. Weights are array leaves: changing them never recompiles.

    Attributes:
        terms: one at least, each with a `weight` and a `name` of its own.
    """

    terms: tuple[AbstractTerm, ...]

    def __check_init__(self) -> None:
        if not self.terms:
            raise InputError("an energy without terms is asked for; give one at least, or take search_energy().")

    def reweight(self, **weights: float | Array) -> "SearchEnergy":
        """Give the energy other weights, by term name: `energy.reweight(view_view=0.0)`."""
        names = [term.name for term in self.terms]
        for name in weights:
            if name not in names:
                raise ValueError(f"no term is called '{name}'; this energy has {', '.join(names)}")
        changed = [
            eqx.tree_at(lambda t: t.weight, term, jnp.asarray(weights[term.name], jnp.float32))
            if term.name in weights
            else term
            for term in self.terms
        ]
        return SearchEnergy(tuple(changed))

    @property
    def weights(self) -> Float[Array, "term"]:
        return jnp.stack([term.weight for term in self.terms])

    def weighted(self, terms: Float[Array, "*particle term"]) -> Float[Array, "*particle"]:
        """Sum the terms by their weights."""
        return jnp.matmul(terms, self.weights, precision="highest")


def search_energy(
    model_view: float = 1.0,
    view_view: float = 0.3,
    *,
    posture: float | None = None,
    uncovered_scale: float = 1.0,
    **view_view_options: Any,
) -> SearchEnergy:
    """Build Eq. 5, E_opt = sum_m E_mv + lambda sum_{m,n} E_vv with lambda = 0.3; without arguments the paper's.

    With a weight for `posture` that term is added.
    """
    terms = (
        ModelView(weight=model_view, uncovered_scale=uncovered_scale),
        ViewView(weight=view_view, **view_view_options),
    )
    return SearchEnergy(terms if posture is None else (*terms, Posture(weight=posture)))


class Scores(NamedTuple):
    """`total (particle,)`, `terms (particle, term)` unweighted, and how many windows were `needed` at most."""

    total: Float[Array, "particle"]
    terms: Float[Array, "particle term"]
    needed: Int[Array, ""]


class Base(NamedTuple):
    """Everything the particles of one group and frame share: the key buffers of the rest of the body with their border,
    what the terms prepared, and how many windows were `needed`."""

    buffers: Int[Array, "camera padded_height padded_width"]
    prepared: tuple[Any, ...]
    needed: Int[Array, ""]


def prepare_base(energy: SearchEnergy, group: GroupProblem, capacity: int) -> Base:
    """Draw the rest of the body and let every term prepare: what `score_particles` takes, once per group and frame.

    `capacity` is how many windows of 8 x 8 pixels the rest may have in a view; `Base.needed` says how many it has, and
    more are left out.
    """
    buffers, needed = base_buffers(group, capacity)
    return Base(buffers, tuple(term.prepare(buffers, group) for term in energy.terms), needed)


def score_particles(
    energy: SearchEnergy,
    group: GroupProblem,
    base: Base,
    increments: Float[Array, "particle dof"],
    capacity: int,
    driver: Driver | None = None,
    live: Bool[Array, "particle"] | None = None,
) -> Scores:
    """Score every increment of the group's pose by Eq. 5; with `live` only those marked, the others fill up the shape.

    An increment has all degrees of freedom, in metres and radians (see `retract`); those that do not move the part are
    taken from it too, so leave them at 0. `capacity` is how many windows of 8 x 8 pixels one view of a particle may
    have, such as 4096. Where `Scores.needed` is more, what did not fit is missing from the scores: take as much.

    With the "loop" driver particles are drawn one after the other into the same key buffers: on a CPU this is far
    faster than `vmap`. With several devices the particles are shared out among them, with the same bits. With "scatter"
    all run at once, for an accelerator. The default is the machine's `best_driver`; keys are the same in both. Raises
    `InputError` for increments of another shape.
    """
    check_shape("increments", increments, ("particle", group.character.skeleton.num_dofs), "a row for each particle")
    driver = driver or best_driver()
    dynamic, static = eqx.partition((energy, group, base), eqx.is_array)

    def generation(arrays: Any, rows: _Rows) -> tuple[Array, Array]:
        energy, group, base = eqx.combine(arrays, static)
        return _score(energy, group, base, rows, capacity, driver)

    terms, needed = _share_out(generation, dynamic, _Rows(increments, live))
    return Scores(energy.weighted(terms), terms, needed.max(initial=0))


class _Rows(NamedTuple):
    """Increments, and which of them to score (None: all)."""

    increments: Float[Array, "particle dof"]
    live: Bool[Array, "particle"] | None


def _score(
    energy: SearchEnergy, group: GroupProblem, base: Base, rows: _Rows, capacity: int, driver: Driver
) -> tuple[Array, Array]:
    """Terms (particle, term) and the windows needed (particle,); 0 for particles that are not live.

    In a loop a particle is drawn into the buffers of the one before, after the rows that one touched are put back.
    """
    (num_cameras, height, width), size = base.buffers.shape, group.frame.size
    skeleton, below, room = group.character.skeleton, base.buffers.reshape(-1, width, 1), group.frame.room

    def one(before: _Canvas, particle: tuple[Pose, Array]) -> tuple[_Canvas, tuple[Array, Array]]:
        pose, posed = particle

        def view(keys: Array, seen: tuple[Array, Array]) -> tuple[Array, tuple[Array, ...]]:
            camera, band = seen
            if driver == "loop":
                keys = put_back(keys, below, band, camera * height)
            listed, places = part_windows(group, posed, camera, capacity, driver)
            keys = draw(keys, listed, group.layout, camera * height, driver)
            band = touched_rows(places, height)
            dirty = dirty_tiles(keys, below, size, band if driver == "loop" else None, camera * height)
            return keys, (band, dirty, pixels_outside(places, size, room[camera]), listed.needed)

        keys, (bands, dirty, outside, needed) = lax.scan(
            view, before.keys, (jnp.arange(num_cameras, dtype=jnp.int32), before.bands)
        )
        drawn = Drawn(pose, keys.reshape(base.buffers.shape), dirty, outside, driver)
        terms = [term.score(own, drawn, group) for term, own in zip(energy.terms, base.prepared, strict=True)]
        return _Canvas(keys, bands), (jnp.stack(terms).astype(rows.increments.dtype), needed.max())

    def one_if(before: _Canvas, row: tuple[Array, tuple[Pose, Array]]) -> tuple[_Canvas, tuple[Array, Array]]:
        nothing = (jnp.zeros(len(energy.terms), rows.increments.dtype), jnp.zeros((), jnp.int32))
        return lax.cond(row[0], one, lambda before, _: (before, nothing), before, row[1])

    moved = jax.vmap(lambda delta: retract(skeleton, group.pose, delta))(rows.increments)
    particles = (moved, jax.vmap(lambda pose: group.part.posed(group.character, pose))(moved))
    clean = _Canvas(below, jnp.zeros((num_cameras, 2), jnp.int32))
    each: Callable[..., Any] = one if rows.live is None else one_if
    values = particles if rows.live is None else (rows.live, particles)
    if driver == "loop":
        return lax.scan(each, clean, values)[1]
    return jax.vmap(lambda value: each(clean, value)[1])(values)


class _Canvas(NamedTuple):
    """The key buffers of all views below each other, and the bands of rows that differ from the base."""

    keys: Int[Array, "row padded_width 1"]
    bands: Int[Array, "camera 2"]


def _share_out(score: Callable[[Any, Any], tuple[Array, Array]], arrays: Any, rows: Any) -> tuple[Array, Array]:
    """Split the particles over the local devices of a CPU; every particle is computed as it would be alone.

    `rows` are arrays whose first axis is the particles'.

    All devices hold all rows and all answers: were they left split up, every sum over particles that a sampler makes
    would have the devices wait for each other, which takes as long as the scores.
    """
    devices, number = jax.local_devices(), jax.tree.leaves(rows)[0].shape[0]
    count = len(devices)
    if count == 1 or number < 2 * count or devices[0].platform != "cpu":
        return score(arrays, rows)
    share = -(-number // count)
    missing = share * count - number
    padded = jax.tree.map(lambda own: jnp.pad(own, ((0, missing), *[(0, 0)] * (own.ndim - 1)), mode="edge"), rows)

    def own(arrays: Any, rows: Any) -> tuple[Array, Array]:
        first = share * lax.axis_index("particle")
        mine = jax.tree.map(lambda all_rows: lax.dynamic_slice_in_dim(all_rows, first, share), rows)
        return lax.all_gather(score(arrays, mine), "particle", tiled=True)

    mesh, every = jax.sharding.Mesh(np.array(devices), ("particle",)), jax.sharding.PartitionSpec()
    shared = jax.shard_map(own, mesh=mesh, in_specs=every, out_specs=every, check_vma=False)
    terms, needed = shared(arrays, padded)
    return terms[:number], needed
