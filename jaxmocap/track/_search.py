"""The sample-based search of sec. 4.1: one group of DoFs at a time, a whole generation of particles per compiled call."""

from dataclasses import dataclass, field

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, PRNGKeyArray

from jaxmocap.character import Character, Pose, retract
from jaxmocap.energies import BodyPart, Region, SearchEnergy, body_part, prepare_base, score_particles
from jaxmocap.observation import FrameProblem
from jaxmocap.samplers import AbstractSampler, run

REGION_STEP = 32


def initial_spread(character: Character) -> Float[np.ndarray, "dof"]:
    """Standard deviation of the first particles per DoF, metres and radians: what the notes to the paper recommend for a
    subject that moves at 1 m/s."""
    degrees = {"clav": 4.0, "lumbar": 6.0, "thorax": 6.0, "neck": 6.0, "shoulder": 12.0, "hip": 12.0, "elbow": 15.0, "knee": 15.0}
    spread = np.full(39, np.deg2rad(10.0))
    spread[:3], spread[3:6] = 0.04, np.deg2rad(6.0)
    for index, name in enumerate(character.skeleton.dof_names):
        for part, value in degrees.items():
            if part in name and index >= 6:
                spread[index] = np.deg2rad(value)
    return spread


class Stage(eqx.Module):
    """Some iterations at one resolution: every `step`-th pixel of the rectangle, with this energy."""

    energy: SearchEnergy
    step: int = eqx.field(static=True, default=1)
    iterations: int = eqx.field(static=True, default=25)


class GroupResult(eqx.Module):
    """`increment (39,)` of the group, the deviation of the last particles (39,), energy before and after, and what the
    static capacities would have had to be."""

    increment: Float[Array, "dof"]
    deviation: Float[Array, "dof"]
    energy_before: Float[Array, ""]
    energy_after: Float[Array, ""]
    needed: Int[Array, ""]
    needed_base: Int[Array, ""]
    needed_far: Int[Array, ""]


class _ParticleEnergy(eqx.Module):
    """Energy of group increments, as an array function a sampler can call."""

    stage: Stage
    character: Character
    part: BodyPart
    pose: Pose
    problem: FrameProblem
    corners: Int[Array, "camera 2"]
    size: tuple[int, int] = eqx.field(static=True)
    capacity: int = eqx.field(static=True)
    base: object

    def scores(self, values: Float[Array, "particle group_dof"]):
        increments = jnp.zeros((values.shape[0], 39)).at[:, jnp.array(self.part.dofs)].set(values)
        region = Region(self.corners, self.size)
        return score_particles(
            self.stage.energy, self.character, self.part, self.pose, self.problem, region, self.base, increments, self.capacity
        )  # fmt: skip

    def __call__(self, values: Float[Array, "particle group_dof"]) -> Float[Array, "particle"]:
        return self.scores(values).total


@eqx.filter_jit
def particle_boxes(
    character: Character, part: BodyPart, pose: Pose, problem: FrameProblem, increments: Float[Array, "particle dof"]
) -> Float[Array, "camera 4"]:
    """Box (left, top, right, bottom) in the rectangle that holds the part for all increments, per view."""

    def box(delta: Array) -> Array:
        vertices = part.posed(character, retract(character.skeleton, pose, delta))
        homogeneous = jnp.einsum("cij,vj->cvi", problem.projection[:, :, :3], vertices) + problem.projection[:, None, :, 3]
        depth = jnp.maximum(homogeneous[..., 2:], 0.05)
        pixels = homogeneous[..., :2] / depth - problem.origins[:, None, ::-1]
        return jnp.concatenate([pixels.min(1), pixels.max(1)], -1)

    boxes = jax.lax.map(box, increments)
    return jnp.concatenate([boxes[..., :2].min(0), boxes[..., 2:].max(0)], -1)


@eqx.filter_jit
def _search(stages, sampler, character, part, pose, problem, corners, size, capacity, base_capacity, spread, lower, upper, key):
    energies, needed_base, needed_far = [], [], []
    for stage in stages:
        coarse = problem.coarser(stage.step)
        region = Region(corners // stage.step, (size[0] // stage.step, size[1] // stage.step))
        base = prepare_base(stage.energy, character, part, pose, coarse, region, base_capacity)
        energies.append(
            (_ParticleEnergy(stage, character, part, pose, coarse, region.corners, region.size, capacity, base), stage.iterations)
        )
        needed_base.append(base.needed)
        needed_far.append(base.needed_far)
    dofs = jnp.array(part.dofs)
    start = jnp.zeros(len(part.dofs))
    best, info = run(sampler, energies, start, spread[dofs], lower[dofs], upper[dofs], key)
    final = energies[-1][0].scores(jnp.stack([start, best]))
    first = energies[0][0].scores(jnp.stack([start, best]))
    return GroupResult(
        increment=jnp.zeros(39).at[dofs].set(best),
        deviation=jnp.zeros(39).at[dofs].set(info.deviation),
        energy_before=final.total[0],
        energy_after=final.total[1],
        needed=jnp.maximum(final.needed, first.needed),
        needed_base=jnp.stack(needed_base).max(),
        needed_far=jnp.stack(needed_far).max(),
    )


@dataclass
class GroupSearch:
    """Searches one group; remembers its static sizes between frames so that they seldom change (host)."""

    part: BodyPart
    capacity: int
    base_capacity: int
    region: tuple[int, int] = (0, 0)
    far_capacity: int = 4096
    recompiled: list[str] = field(default_factory=list)

    @staticmethod
    def create(character: Character, name: str, dofs: tuple[int, ...]) -> "GroupSearch":
        part = body_part(character, name, dofs)
        capacity = max(256, 2 ** int(np.ceil(np.log2(part.faces.shape[1] * 1.1))))
        base_capacity = max(256, 2 ** int(np.ceil(np.log2(character.faces.shape[0] * 1.1))))
        return GroupSearch(part, capacity, base_capacity)

    def place_region(self, boxes: Float[np.ndarray, "camera 4"], problem: FrameProblem) -> Int[np.ndarray, "camera 2"]:
        """Corners of the region in the rectangle; the size grows in steps of 32 and never beyond the rectangle."""
        height, width = problem.size
        if min(self.part.dofs) < 6:
            self.region = (height, width)
            return np.zeros((len(boxes), 2), np.int32)
        boxes = np.clip(np.nan_to_num(boxes), -64, [width + 64, height + 64, width + 64, height + 64])
        extent = (boxes[:, 2:] - boxes[:, :2]).max(0) + 32
        wanted = [int(-(-extent[axis] // REGION_STEP) * REGION_STEP) for axis in (1, 0)]
        size = tuple(min(max(w, r), full // 8 * 8) for w, r, full in zip(wanted, self.region, (height, width), strict=True))
        self.region = (size[0], size[1])
        centre = 0.5 * (boxes[:, :2] + boxes[:, 2:])
        top = np.clip(centre[:, 1] - size[0] / 2, 0, height - size[0])
        left = np.clip(centre[:, 0] - size[1] / 2, 0, width - size[1])
        return (np.stack([top, left], -1) // 8 * 8).astype(np.int32)

    def __call__(
        self,
        stages: tuple[Stage, ...],
        sampler: AbstractSampler,
        character: Character,
        pose: Pose,
        problem: FrameProblem,
        spread: Float[np.ndarray, "dof"],
        key: PRNGKeyArray,
    ) -> GroupResult:
        """Search the group around `pose`. A capacity that overflows is enlarged and the search run again."""
        skeleton = character.skeleton
        free = jnp.array([0.5, 0.5, 0.5, 1.2, 1.2, 1.2])
        lower = jnp.concatenate([-free, skeleton.lower - pose.angles])
        upper = jnp.concatenate([free, skeleton.upper - pose.angles])
        spread = jnp.asarray(spread, jnp.float32)
        dofs = np.array(self.part.dofs)
        cloud = np.zeros((2 * len(dofs) + 1, 39), np.float32)
        for row, dof in enumerate(dofs):
            cloud[2 * row, dof], cloud[2 * row + 1, dof] = 1.7 * spread[dof], -1.7 * spread[dof]
        boxes = np.asarray(particle_boxes(character, self.part, pose, problem, jnp.asarray(cloud)))
        corners = jnp.asarray(self.place_region(boxes, problem))
        while True:
            result = _search(
                stages, sampler, character, self.part, pose, problem, corners, self.region, self.capacity,
                self.base_capacity, spread, lower, upper, key,
            )  # fmt: skip
            needed, needed_base = int(result.needed), int(result.needed_base)
            if needed <= self.capacity and needed_base <= self.base_capacity:
                return result
            self.capacity = max(self.capacity, 2 ** (needed - 1).bit_length())
            self.base_capacity = max(self.base_capacity, 2 ** (needed_base - 1).bit_length())
