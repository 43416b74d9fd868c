"""Eq. 5 and its relatives: a weighted sum of terms, scored for a whole generation of particles in one compiled call."""

from typing import Any, NamedTuple, Protocol

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from jaxmocap.character import Character, Pose, retract
from jaxmocap.observation import FrameProblem
from jaxmocap.render import draw, restore

from ._body import BodyPart, Region, base_buffers, part_jobs, pixels_outside
from ._model_view import ModelView
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


class SearchEnergy(eqx.Module):
    """A weighted sum of terms of the rendered pose. Weights are array leaves: changing them never recompiles."""

    terms: tuple[Any, ...]

    def reweight(self, **weights: float | Array) -> "SearchEnergy":
        """The same energy with other weights, by term name: `energy.reweight(view_view=0.0)`."""
        names = [term.name for term in self.terms]
        for name in weights:
            if name not in names:
                raise ValueError(f"no term is called '{name}'; this energy has {', '.join(names)}")
        changed = [
            eqx.tree_at(lambda t: t.weight, term, jnp.asarray(weights[term.name], jnp.float32)) if term.name in weights else term
            for term in self.terms
        ]
        return SearchEnergy(tuple(changed))


def search_energy(model_view: float = 1.0, view_view: float = 0.3, **view_view_options: Any) -> SearchEnergy:
    """Eq. 5: E_opt = sum_m E_mv + lambda sum_{m,n} E_vv with lambda = 0.3."""
    return SearchEnergy((ModelView(weight=model_view), ViewView(weight=view_view, **view_view_options)))


class Scores(NamedTuple):
    """`total (particle,)`, `terms (particle, term)` unweighted, and how many windows were `needed` at most."""

    total: Float[Array, "particle"]
    terms: Float[Array, "particle term"]
    needed: Int[Array, ""]


class Base(NamedTuple):
    """Everything the particles of one group and frame share."""

    buffers: Int[Array, "camera padded_height padded_width"]
    prepared: tuple[Any, ...]
    needed: Int[Array, ""]
    needed_far: Int[Array, ""]


def prepare_base(
    energy: SearchEnergy, character: Character, part: BodyPart, pose: Pose, problem: FrameProblem, region: Region, capacity: int
) -> Base:
    """Draw the rest of the body at `pose` and let every term prepare."""
    buffers, needed = base_buffers(character, part, pose, problem, capacity)
    prepared = tuple(term.prepare(buffers, region, problem, part.layout) for term in energy.terms)
    far = jnp.zeros((), jnp.int32)
    for term, ready in zip(energy.terms, prepared, strict=True):
        if isinstance(term, ViewView):
            far = jnp.maximum(far, term.needed(ready))
    return Base(buffers, prepared, needed, far)


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
) -> Scores:
    """Eq. 5 for every increment of `pose`. Particles run one after the other over one key buffer, which is put back after
    each: on a CPU this is far faster than `vmap`."""
    layout = part.layout
    vertices = jax.vmap(lambda delta: part.posed(character, retract(character.skeleton, pose, delta)))(increments)

    def one(buffers: Array, posed: Array) -> tuple[Array, tuple[Array, Array]]:
        drawn, all_jobs, outside = [], [], []
        for camera in range(problem.num_cameras):
            jobs, screen = part_jobs(part, posed, problem, camera, capacity)
            outside.append(pixels_outside(screen, part.faces, region.corners[camera], region.size))
            drawn.append(draw(buffers[camera], jobs, layout))
            all_jobs.append(jobs)
        drawn_buffers = tuple(drawn)
        values = [
            term.score(ready, drawn_buffers, jnp.stack(outside), region, problem, layout)
            for term, ready in zip(energy.terms, base.prepared, strict=True)
        ]
        clean = tuple(restore(drawn[c], base.buffers[c], all_jobs[c]) for c in range(problem.num_cameras))
        return clean, (jnp.stack(values), jnp.stack([jobs.needed for jobs in all_jobs]).max())

    start = tuple(base.buffers[c] for c in range(problem.num_cameras))
    _, (terms, needed) = lax.scan(one, start, vertices)
    weights = jnp.stack([term.weight for term in energy.terms])
    return Scores(terms @ weights, terms, needed.max())
