"""Eq. 5 and its relatives: a weighted sum of terms, scored for a whole generation of particles in one compiled call."""

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol, cast, runtime_checkable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int

from jaxmocap.character import Character, Pose, Skeleton, retract
from jaxmocap.observation import FrameProblem
from jaxmocap.render import WINDOW, Driver, best_driver, draw

from ._body import BodyPart, Region, base_buffers, part_jobs, pixels_outside
from ._model_view import ModelView
from ._posture import Posture
from ._view_view import ViewView


class SearchTerm(Protocol):
    """A term of the search energy: scores key buffers. A new term is one file with these members.

    `prepare(base, region, problem, layout)` computes once per group what no particle changes; `score(prepared, buffers,
    outside, region, problem, layout)` returns a scalar.
    """

    name: str
    weight: Float[Array, ""]

    def prepare(self, base, region, problem, layout) -> Any: ...

    def score(self, prepared, buffers, outside, region, problem, layout) -> Float[Array, ""]: ...


@runtime_checkable
class PoseTerm(Protocol):
    """A term of the search energy that looks at the pose itself, not at what is drawn."""

    name: str
    weight: Float[Array, ""]

    def score_pose(self, skeleton: Skeleton, pose: Pose, problem: FrameProblem) -> Float[Array, ""]: ...


class SearchEnergy(eqx.Module):
    """A weighted sum of terms (`SearchTerm`, `PoseTerm`). Weights are array leaves: changing them never recompiles."""

    terms: tuple[Any, ...]

    def reweight(self, **weights: float | Array) -> "SearchEnergy":
        """The same energy with other weights, by term name: `energy.reweight(view_view=0.0)`."""
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


def search_energy(
    model_view: float = 1.0,
    view_view: float = 0.3,
    *,
    posture: float | None = None,
    uncovered_scale: float = 1.0,
    **view_view_options: Any,
) -> SearchEnergy:
    """Eq. 5: E_opt = sum_m E_mv + lambda sum_{m,n} E_vv with lambda = 0.3; without arguments the paper's. With a weight
    for `posture` that term is added."""
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
    """Everything the particles of one group and frame share: the region's part of the base key buffers with its border,
    and what the terms prepared."""

    buffers: Int[Array, "camera padded_region_height padded_region_width"]
    prepared: tuple[Any, ...]
    needed: Int[Array, ""]
    needed_far: Int[Array, ""]


def prepare_base(
    energy: SearchEnergy,
    character: Character,
    part: BodyPart,
    pose: Pose,
    problem: FrameProblem,
    region: Region,
    capacity: int,
) -> Base:
    """Draw the rest of the body at `pose` and let every term prepare."""
    buffers, needed = base_buffers(character, part, pose, problem, capacity)
    prepared = tuple(
        () if isinstance(term, PoseTerm) else term.prepare(buffers, region, problem, part.layout)
        for term in energy.terms
    )
    far = jnp.zeros((), jnp.int32)
    for term, ready in zip(energy.terms, prepared, strict=True):
        if isinstance(term, ViewView):
            far = jnp.maximum(far, term.needed(cast(Any, ready)))
    cut = jnp.stack([region.cut(buffers[c], c, border=WINDOW) for c in range(problem.num_cameras)])
    return Base(cut, prepared, needed, far)


def score_particles(
    energy: SearchEnergy,
    character: Character,
    part: BodyPart,
    pose: Pose,
    problem: FrameProblem,
    region: Region,
    base: Base,
    increments: Float[Array, "particle dof"],
    capacity: int,
    driver: Driver | None = None,
) -> Scores:
    """Eq. 5 for every increment of `pose`.

    With the "loop" driver particles run one after the other over copies of a small key buffer: on a CPU this is far
    faster than `vmap`. With several devices the particles are shared out among them, with the same bits. With "scatter"
    all run at once, for an accelerator. The default is the machine's `best_driver`; keys are the same in both.
    """
    driver = driver or best_driver()
    dynamic, static = eqx.partition((energy, character, part, pose, problem, region, base), eqx.is_array)

    def generation(arrays: Any, rows: Array) -> tuple[Array, Array]:
        energy, character, part, pose, problem, region, base = eqx.combine(arrays, static)
        return _score(energy, character, part, pose, problem, region, base, rows, capacity, driver)

    terms, needed = _share_out(generation, dynamic, increments)
    weights = jnp.stack([term.weight for term in energy.terms])
    return Scores(terms @ weights, terms, needed.max())


def _score(energy, character, part, pose, problem, region, base, increments, capacity, driver) -> tuple[Array, Array]:
    """Terms (particle, term) and the windows needed (particle,)."""
    layout, (height, width) = part.layout, base.buffers.shape[1:]

    def one(particle: tuple[Pose, Array]) -> tuple[Array, Array]:
        moved, posed = particle

        def view(below: Array, camera: Array) -> tuple[Array, tuple[Array, Array]]:
            jobs, places = part_jobs(part, posed, problem, camera, region, capacity, driver)
            outside = pixels_outside(places, region.corners[camera], region.size)
            return draw(below, jobs, layout, camera * height, driver), (outside, jobs.needed)

        drawn, (outside, needed) = lax.scan(view, base.buffers.reshape(-1, width, 1), jnp.arange(problem.num_cameras))
        drawn = drawn.reshape(base.buffers.shape)
        values = [
            term.score_pose(character.skeleton, moved, problem)
            if isinstance(term, PoseTerm)
            else term.score(ready, drawn, outside, region, problem, layout)
            for term, ready in zip(energy.terms, base.prepared, strict=True)
        ]
        return jnp.stack(values), needed.max()

    moved = jax.vmap(lambda delta: retract(character.skeleton, pose, delta))(increments)
    particles = (moved, jax.vmap(lambda pose: part.posed(character, pose))(moved))
    return lax.map(one, particles) if driver == "loop" else jax.vmap(one)(particles)


def _share_out(
    score: Callable[[Any, Array], tuple[Array, Array]], arrays: Any, rows: Float[Array, "particle dof"]
) -> tuple[Array, Array]:
    """Split the particles over the local devices of a CPU; every particle is computed as it would be alone.

    All devices hold all rows and all answers: were they left split up, every sum over particles that a sampler makes
    would have the devices wait for each other, which takes as long as the scores.
    """
    devices = jax.local_devices()
    count = len(devices)
    if count == 1 or rows.shape[0] < 2 * count or devices[0].platform != "cpu":
        return score(arrays, rows)
    share = -(-rows.shape[0] // count)
    padded = jnp.pad(rows, ((0, share * count - rows.shape[0]), (0, 0)), mode="edge")

    def own(arrays: Any, rows: Array) -> tuple[Array, Array]:
        mine = lax.dynamic_slice_in_dim(rows, share * lax.axis_index("particle"), share)
        return lax.all_gather(score(arrays, mine), "particle", tiled=True)

    mesh, every = jax.sharding.Mesh(np.array(devices), ("particle",)), jax.sharding.PartitionSpec()
    shared = jax.shard_map(own, mesh=mesh, in_specs=every, out_specs=every, check_vma=False)
    terms, needed = shared(arrays, padded)
    return terms[: rows.shape[0]], needed
