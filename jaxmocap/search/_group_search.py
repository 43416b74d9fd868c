"""The sample-based search of sec. 4.1: one group of DoFs at a time, a whole generation of particles per compiled
call."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from jaxmocap._cache import cached_jit, optimised_jit
from jaxmocap.character import Character, Pose, retract
from jaxmocap.energies import (
    Base,
    BodyPart,
    GroupProblem,
    SearchEnergy,
    part_windows,
    prepare_base,
    score_particles,
)
from jaxmocap.observation import FrameProblem
from jaxmocap.samplers import AbstractSampler, Pool, run

from ._drawn_meshes import Groups, Mesh, alike_parts, is_limb, power_of_two

ROOT_REACH = (0.5, 0.5, 0.5, 1.2, 1.2, 1.2)
"""Half widths of the box in which the root is searched, metres and radians."""

POOL = 20
"""As many particles are drawn for each one that starts further afield; the best ones are taken."""


class Stage(eqx.Module):
    """Some iterations at one resolution: every `step`-th pixel of the rectangle, with this energy and the mesh that
    keeps this share of its faces."""

    energy: SearchEnergy
    step: int = eqx.field(static=True, default=1)
    iterations: int = eqx.field(static=True, default=25)
    faces: float = eqx.field(static=True, default=1.0)


class GroupResult(eqx.Module):
    """`increment (dof,)` of the group, the deviation of the last particles (dof,), the energy of the answer, and what
    the static capacities would have had to be."""

    increment: Float[Array, "dof"]
    deviation: Float[Array, "dof"]
    energy: Float[Array, ""]
    needed: Int[Array, "stage"]
    needed_base: Int[Array, ""]


class Reach(NamedTuple):
    """Where the particles of a search may go.

    Attributes:
        wide: share of the first particles that look further afield, see `wide_population`.
        within: how many times the spread a particle may go.
        prior: what a particle pays for leaving the start, see `SearchPlan`.
    """

    wide: float = 0.0
    within: float = np.inf
    prior: float = 0.0


ANYWHERE = Reach()
"""Within the joint limits, and drawn around the start."""


class _Box(NamedTuple):
    """Of every degree of freedom: deviation of the first particles, and limits of the increment."""

    spread: Float[Array, "*dof"]
    lower: Float[Array, "*dof"]
    upper: Float[Array, "*dof"]


class _Level(eqx.Module):
    """A stage with what it draws: the part of a simplified mesh, or (None) of the character's own, in so many
    windows."""

    stage: Stage
    mesh: Mesh | None
    part: BodyPart
    capacity: int = eqx.field(static=True)

    def of(self, group: GroupProblem) -> GroupProblem:
        """Return the group as this stage sees it."""
        character, frame = group.character, group.frame.coarser(self.stage.step)
        if self.mesh is not None:
            character, frame = self.mesh.character, replace(frame, surface=self.mesh.surface)
        return GroupProblem(character, self.part, group.pose, frame)


class _ParticleEnergy(eqx.Module):
    """Energy of group increments and their prior, as an array function a sampler can call. A particle whose windows do
    not fit into the capacity counts as not finite; the capacity is chosen so that this does not happen near the answer.
    """

    energy: SearchEnergy
    group: GroupProblem
    base: Base
    spread: Float[Array, "group_dof"]
    prior: Float[Array, ""]
    capacity: int = eqx.field(static=True)

    def __call__(self, values: Float[Array, "particle group_dof"]) -> Float[Array, "particle"]:
        still = jnp.zeros((values.shape[0], self.group.character.skeleton.num_dofs))
        increments = still.at[:, self.group.part.dofs].set(values, mode="drop")
        scores = score_particles(self.energy, self.group, self.base, increments, self.capacity)
        moved = (values / jnp.maximum(self.spread, 1e-6)) ** 2
        total = scores.total + self.prior * jnp.sum(moved / (1 + moved), axis=1)
        return jnp.where(scores.needed > self.capacity, jnp.nan, total)


def wide_population(
    key: PRNGKeyArray,
    count: int,
    spread: Float[Array, "group_dof"],
    lower: Float[Array, "group_dof"],
    upper: Float[Array, "group_dof"],
    distal: Bool[Array, "group_dof"],
) -> Float[Array, "extra group_dof"]:
    """Draw first particles for a limb that moves faster than expected, or that was lost.

    In turn: Gaussian with three times the spread; drawn evenly from the box, not farther than twelve times the spread;
    and for the `distal` DOFs drawn evenly from all of it but Gaussian for the others, for a forearm or shin that left
    its place alone.
    """
    near_key, far_key = jax.random.split(key)
    normal = spread * jax.random.normal(near_key, (count, spread.shape[0]))
    low, high = jnp.maximum(lower, -12 * spread), jnp.minimum(upper, 12 * spread)
    even = jax.random.uniform(far_key, normal.shape)
    turn = jnp.arange(count)[:, None] % 3
    anywhere = jnp.where(distal, lower + even * (upper - lower), normal)
    values = jnp.select([turn == 0, turn == 1], [3.0 * normal, low + even * (high - low)], anywhere)
    return jnp.clip(values, lower, upper)


@cached_jit
def _prepare(levels: tuple[_Level, ...], group: GroupProblem, capacity: int) -> tuple[Base, ...]:
    """Prepare what the particles share at each level; the part is `unseen`, so that groups share the program."""
    return tuple(prepare_base(level.stage.energy, level.of(group), capacity) for level in levels)


@optimised_jit
def _search(
    levels: tuple[_Level, ...],
    bases: tuple[Base, ...],
    sampler: AbstractSampler,
    group: GroupProblem,
    box: _Box,
    distal: Bool[Array, "group_dof"],
    wide: float,
    prior: Float[Array, ""],
    key: PRNGKeyArray,
) -> GroupResult:
    dofs, skeleton = group.part.dofs, group.character.skeleton
    own = _Box(*(values.at[dofs].get(mode="fill", fill_value=0.0) for values in box))  # no spread: it stays
    scored, seen = [], [level.of(group) for level in levels]
    for level, base, coarse in zip(levels, bases, seen, strict=True):
        energy = _ParticleEnergy(level.stage.energy, coarse, base, own.spread, prior, level.capacity)
        scored.append((energy, level.stage.iterations))
    pool, count = None, int(wide * sampler.num_particles)
    if count > 0:
        key, pool_key = jax.random.split(key)
        pool = Pool(wide_population(pool_key, POOL * count, *own, distal), count)
    best, info = run(sampler, scored, jnp.zeros(dofs.shape[0]), *own, key, pool=pool)
    increment = jnp.zeros(skeleton.num_dofs).at[dofs].set(best, mode="drop")
    needed = []
    for level, coarse in zip(levels, seen, strict=True):

        def windows(posed: Array, coarse=coarse, capacity=level.capacity) -> Array:
            cameras = jnp.arange(coarse.frame.num_cameras)
            return jax.lax.map(lambda camera: part_windows(coarse, posed, camera, capacity)[0].needed, cameras).max()

        poses = (group.pose, retract(skeleton, group.pose, increment))
        posed = jnp.stack([level.part.posed(group.character, pose) for pose in poses])
        needed.append(jax.lax.map(windows, posed).max())
    return GroupResult(
        increment=increment,
        deviation=jnp.zeros(skeleton.num_dofs).at[dofs].set(info.deviation, mode="drop"),
        energy=info.energy,
        needed=jnp.stack(needed),
        needed_base=jnp.stack([base.needed for base in bases]).max(),
    )


@dataclass
class Sizes:
    """Static sizes of a compiled search, which only grow; limbs share them, and so do root and torso. Windows are
    counted by resolution and mesh: (step, share of the faces)."""

    base_capacity: int
    capacity: dict[tuple[int, float], int] = field(default_factory=dict)


@dataclass
class GroupSearch:
    """Searches one group; its sizes are remembered between frames so that they seldom change (host)."""

    name: str
    dofs: tuple[int, ...]
    part: BodyPart
    simple: dict[float, tuple[Mesh, BodyPart]] = field(default_factory=dict)
    sizes: Sizes = field(default_factory=lambda: Sizes(256))
    distal: Bool[Array, "group_dof"] = field(default_factory=lambda: jnp.zeros(0, bool))

    def __call__(
        self,
        stages: tuple[Stage, ...],
        sampler: AbstractSampler,
        character: Character,
        pose: Pose,
        problem: FrameProblem,
        spread: Float[np.ndarray, "dof"],
        key: PRNGKeyArray,
        reach: Reach = ANYWHERE,
    ) -> GroupResult:
        """Search the group around `pose`. A capacity that overflows is enlarged and the search run again."""
        task, sizes = self._task(stages, character, pose, problem, spread, reach), self.sizes
        while True:
            result = _search(*self._arguments(stages, sampler, task, key, reach))
            result = jax.tree.map(lambda leaf: jax.device_put(np.asarray(leaf)), result)
            needed_base = int(result.needed_base)
            needed = {_name(stage): int(count) for stage, count in zip(stages, result.needed, strict=True)}
            fits = all(1.1 * count <= sizes.capacity[level] for level, count in needed.items())
            if fits and needed_base <= sizes.base_capacity:
                return result
            for level, count in needed.items():
                sizes.capacity[level] = max(sizes.capacity[level], power_of_two(1.2 * count))
            sizes.base_capacity = max(sizes.base_capacity, power_of_two(1.1 * needed_base))

    def _task(
        self,
        stages: tuple[Stage, ...],
        character: Character,
        pose: Pose,
        problem: FrameProblem,
        spread: Float[np.ndarray, "dof"],
        reach: Reach,
    ) -> "_Task":
        """Bound the increments, and find what each stage draws."""
        skeleton = character.skeleton
        free, angles = np.array(ROOT_REACH, np.float32), np.asarray(pose.angles)
        lower = np.concatenate([-free, np.asarray(skeleton.lower) - angles])
        upper = np.concatenate([free, np.asarray(skeleton.upper) - angles])
        if np.isfinite(reach.within):
            farthest = reach.within * np.asarray(spread, np.float32)
            lower, upper = np.maximum(lower, -farthest), np.minimum(upper, farthest)
        drawn = [self.simple.get(stage.faces, (None, self.part)) for stage in stages]
        meshes, part = [mesh for mesh, _ in drawn if mesh is not None], self.part
        if len(meshes) == len(drawn):  # the character's own mesh then leaves no trace in the shapes
            character, problem, part = meshes[0].character, replace(problem, surface=meshes[0].surface), drawn[0][1]
        box = _Box(*jax.device_put((np.asarray(spread, np.float32), lower, upper)))
        return _Task(GroupProblem(character, part, pose, problem), box, drawn)

    def _arguments(
        self, stages: tuple[Stage, ...], sampler: AbstractSampler, task: "_Task", key: PRNGKeyArray, reach: Reach
    ) -> tuple[Any, ...]:
        """Prepare what the particles share, and list what `_search` takes."""
        sizes, group, levels = self.sizes, task.group, []
        for stage, (mesh, part) in zip(stages, task.drawn, strict=True):
            capacity = sizes.capacity.setdefault(_name(stage), power_of_two(1.3 * part.faces.shape[1]))
            levels.append(_Level(stage, mesh, part, capacity))
        unseen = tuple(replace(level, part=level.part.unseen()) for level in levels)
        bases = _prepare(unseen, replace(group, part=group.part.unseen()), sizes.base_capacity)
        chance = (self.distal, reach.wide, jnp.float32(reach.prior))
        return tuple(levels), bases, sampler, group, task.box, *chance, key


class _Task(NamedTuple):
    """A group, the bounds of its increments, and the mesh and part that each stage draws."""

    group: GroupProblem
    box: _Box
    drawn: Sequence[tuple[Mesh | None, BodyPart]]


def _name(stage: Stage) -> tuple[int, float]:
    """Name a stage in `Sizes`."""
    return stage.step, stage.faces


def group_searches(
    character: Character, meshes: Mapping[float, Mesh] | None = None, groups: Groups | None = None
) -> list[GroupSearch]:
    """Make one search per group, by default those of the skeleton.

    `meshes` holds a simplified mesh for every share of the faces that a stage names, except 1.
    """
    skeleton = character.skeleton
    groups = skeleton.groups if groups is None else groups
    parts = alike_parts(character, groups)
    simple = {share: (mesh, alike_parts(mesh.character, groups)) for share, mesh in (meshes or {}).items()}
    shared: dict[bool, Sizes] = {}
    searches = []
    for name, dofs in groups:
        sizes = shared.setdefault(is_limb(skeleton, name), Sizes(power_of_two(1.3 * character.faces.shape[0])))
        coarser = {share: (mesh, there[name]) for share, (mesh, there) in simple.items()}
        distal = jax.device_put(np.isin(np.asarray(parts[name].dofs), skeleton.distal))
        searches.append(GroupSearch(name, dofs, parts[name], coarser, sizes, distal))
    return searches
