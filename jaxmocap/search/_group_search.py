"""The sample-based search of sec. 4.1: one group of DoFs at a time, a whole generation of particles per compiled
call."""

from dataclasses import dataclass, replace
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from jaxmocap._cache import cached_jit, optimised_jit
from jaxmocap.character import Character, Pose, retract
from jaxmocap.energies import Base, BodyPart, GroupProblem, SearchEnergy, part_windows, prepare_base, score_particles
from jaxmocap.observation import FrameProblem, Surface
from jaxmocap.samplers import AbstractSampler, Pool, run

from ._drawn_meshes import Groups, Mesh, alike_parts, power_of_two

ROOT_REACH = (0.5, 0.5, 0.5, 1.2, 1.2, 1.2)
"""Half widths of the box in which the root is searched, metres and radians."""

POOL = 20
"""As many particles are drawn for each one that starts further afield; the best ones are taken."""


class GroupResult(eqx.Module):
    """`increment (dof,)` of the group, the deviation of the last particles (dof,), the energy of the answer, and what
    the static capacities would have had to be."""

    increment: Float[Array, "dof"]
    deviation: Float[Array, "dof"]
    energy: Float[Array, ""]
    needed: Int[Array, ""]
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


class _Region(NamedTuple):
    """Where the particles of one group go: of every degree of freedom the deviation of the first particles and the
    limits of the increment, which of the group's own are `distal`, and `wide` and `prior` of `Reach`."""

    spread: Float[Array, "dof"]
    lower: Float[Array, "dof"]
    upper: Float[Array, "dof"]
    distal: Bool[Array, "group_dof"]
    wide: float
    prior: Float[Array, ""]


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
def _prepare(energy: SearchEnergy, group: GroupProblem, step: int, capacity: int) -> Base:
    """Prepare what the particles share; the part is `unseen`, so that groups share the program."""
    return prepare_base(energy, replace(group, frame=group.frame.coarser(step)), capacity)


@optimised_jit
def _search(
    energy: SearchEnergy,
    base: Base,
    sampler: AbstractSampler,
    group: GroupProblem,
    step: int,
    capacity: int,
    region: _Region,
    key: PRNGKeyArray,
) -> GroupResult:
    dofs, skeleton = group.part.dofs, group.character.skeleton
    group = replace(group, frame=group.frame.coarser(step))
    everyone = (region.spread, region.lower, region.upper)
    spread, lower, upper = (of.at[dofs].get(mode="fill", fill_value=0.0) for of in everyone)  # no spread: it stays
    scored = _ParticleEnergy(energy, group, base, spread, region.prior, capacity)
    pool, count = None, int(region.wide * sampler.num_particles)
    if count > 0:
        key, pool_key = jax.random.split(key)
        pool = Pool(wide_population(pool_key, POOL * count, spread, lower, upper, region.distal), count)
    best, info = run(sampler, scored, jnp.zeros(dofs.shape[0]), spread, lower, upper, key, pool=pool)
    increment = jnp.zeros(skeleton.num_dofs).at[dofs].set(best, mode="drop")

    def windows(posed: Float[Array, "part_vertex 3"]) -> Int[Array, ""]:
        cameras = jnp.arange(group.frame.num_cameras)
        return jax.lax.map(lambda camera: part_windows(group, posed, camera, capacity)[0].needed, cameras).max()

    poses = (group.pose, retract(skeleton, group.pose, increment))
    posed = jnp.stack([group.part.posed(group.character, pose) for pose in poses])
    return GroupResult(
        increment=increment,
        deviation=jnp.zeros(skeleton.num_dofs).at[dofs].set(info.deviation, mode="drop"),
        energy=info.energy,
        needed=jax.lax.map(windows, posed).max(),
        needed_base=base.needed,
    )


@dataclass
class Sizes:
    """Static sizes of a compiled search, which only grow: windows of the body without the part, and of the part. Limbs
    share them, and so do root and torso."""

    base_capacity: int
    capacity: int


@dataclass
class GroupSearch:
    """Searches one group; its sizes are remembered between frames so that they seldom change (host).

    Particles are scored by `energy` at every `step`-th pixel. The `character` that is drawn, and the `part` of it that
    moves, may be of a simplified mesh, whose `surface` then takes the place of the frame's.
    """

    name: str
    dofs: tuple[int, ...]
    energy: SearchEnergy
    step: int
    character: Character
    part: BodyPart
    surface: Surface | None
    sizes: Sizes
    distal: Bool[Array, "group_dof"]

    def __call__(
        self,
        sampler: AbstractSampler,
        pose: Pose,
        problem: FrameProblem,
        spread: Float[np.ndarray, "dof"],
        key: PRNGKeyArray,
        reach: Reach = ANYWHERE,
    ) -> GroupResult:
        """Search the group around `pose`. A capacity that overflows is enlarged and the search run again."""
        problem = problem if self.surface is None else replace(problem, surface=self.surface)
        group = GroupProblem(self.character, self.part, pose, problem)
        unseen = replace(group, part=self.part.unseen())
        region = self._region(pose, spread, reach)
        sizes = self.sizes
        while True:
            base = _prepare(self.energy, unseen, self.step, sizes.base_capacity)
            found = _search(self.energy, base, sampler, group, self.step, sizes.capacity, region, key)
            result = jax.device_get(found)
            needed, needed_base = int(result.needed), int(result.needed_base)
            if 1.1 * needed <= sizes.capacity and needed_base <= sizes.base_capacity:
                return jax.device_put(result)
            sizes.capacity = max(sizes.capacity, power_of_two(1.2 * needed))
            sizes.base_capacity = max(sizes.base_capacity, power_of_two(1.1 * needed_base))

    def _region(self, pose: Pose, spread: Float[np.ndarray, "dof"], reach: Reach) -> _Region:
        """Bound the increments by the joint limits, and by the spread where they may not go far."""
        skeleton, spread = self.character.skeleton, np.asarray(spread, np.float32)
        free, angles = np.array(ROOT_REACH, np.float32), np.asarray(pose.angles)
        lower = np.concatenate([-free, np.asarray(skeleton.lower) - angles])
        upper = np.concatenate([free, np.asarray(skeleton.upper) - angles])
        if np.isfinite(reach.within):
            farthest = reach.within * spread
            lower, upper = np.maximum(lower, -farthest), np.minimum(upper, farthest)
        box = jax.device_put((spread, lower, upper))
        return _Region(*box, distal=self.distal, wide=reach.wide, prior=jnp.float32(reach.prior))


def group_searches(
    character: Character, energy: SearchEnergy, step: int = 1, mesh: Mesh | None = None, groups: Groups | None = None
) -> list[GroupSearch]:
    """Make one search per group, by default those of the skeleton; `mesh` is drawn instead of the character's own."""
    skeleton = character.skeleton
    groups = skeleton.groups if groups is None else groups
    drawn, surface = (character, None) if mesh is None else (mesh.character, mesh.surface)
    parts = alike_parts(drawn, groups)
    shared: dict[bool, Sizes] = {}
    searches = []
    for name, dofs in groups:
        part = parts[name]
        first = Sizes(*(power_of_two(1.3 * count) for count in (character.faces.shape[0], part.faces.shape[1])))
        sizes = shared.setdefault(name in skeleton.limbs, first)
        distal = jax.device_put(np.isin(np.asarray(part.dofs), skeleton.distal))
        searches.append(GroupSearch(name, dofs, energy, step, drawn, part, surface, sizes, distal))
    return searches
