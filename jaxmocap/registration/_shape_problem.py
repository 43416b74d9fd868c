"""Body shape, detector offsets and one pose per frame as one least-squares problem."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxmocap._types import Scalar, knob
from jaxmocap.character import (
    GIRTHS,
    LENGTHS,
    ROOT_DOFS,
    BodyShape,
    Character,
    Pose,
    Skeleton,
    body_transforms,
    landmark_positions,
    retract,
    scaled,
    stature,
)
from jaxmocap.energies import LandmarkRays, LineResidual, SurfaceLines, bend
from jaxmocap.observation import carriers
from jaxmocap.refiners import AbstractRefiner, RefineProblem

OFFSETS = ("shoulder", "hip", "nose", "eye", "ear", "toe", "heel")
"""Detector points that are another place than our landmark of the name."""

_COUPLED = {"torso": ("shoulders", "hips")} | {name: (name,) for name in GIRTHS if name != "torso"}


class ShapePrior(eqx.Module):
    """Independent Gaussians that keep a fitted body human: standard deviations of logarithms of scales, unless said
    otherwise.

    They are ours, of the order of the coefficients of variation among adults (Gordon et al., 2012 Anthropometric Survey
    of U.S. Army Personnel, NATICK/TR-15/007, 2014). The means are the generic character's own proportions.

    Attributes:
        height: of the whole body; about 4 % within a sex.
        measured: of the height where it is known. Shoes, posture and a tape measure leave 0.005 open; less, for a few
            thousand points of outlines, which hair and caps pull up together, stand against this one row.
        length: of a bone; about 5 %.
        extremity: of head, hand and foot.
        girth: of a girth; about 10 %.
        coupling: mean of a girth's logarithm as a share of its bones'.
        offset: of a detector's idea of a landmark, metres: one vector for all frames, mirrored between the sides.
        posture: how far spine, neck and collar bones bend, as a share of their limits.
        angle: radians; keeps what no keypoint shows near the start.
        widest: standard deviations that are never exceeded.
    """

    height: Scalar = knob(0.06)
    measured: Scalar = knob(0.002)
    length: Scalar = knob(0.05)
    extremity: Scalar = knob(0.03)
    girth: Scalar = knob(0.10)
    coupling: Scalar = knob(0.5)
    offset: Scalar = knob(0.02)
    posture: Scalar = knob(0.5)
    angle: Scalar = knob(2.0)
    widest: Scalar = knob(3.0)


class FramesSeen(eqx.Module):
    """What is seen of the body, each leaf with a leading frame axis; `base` are the poses that increments start from.

    `contours` are points of the mesh tied to the outlines of masks in the frames `outlined`, with the scales of
    `LineResidual`, or None.
    """

    base: Pose
    rays: LandmarkRays
    contours: tuple[SurfaceLines, Float[Array, "outlined row"], Float[Array, "outlined row"]] | None = None
    outlined: tuple[int, ...] = eqx.field(static=True, default=())


class Unknowns(eqx.Module):
    """The solution as named parts."""

    shape: BodyShape
    offsets: Float[Array, "offset 3"]
    deltas: Float[Array, "frame dof"]


class ShapeProblem(eqx.Module):
    """Shape and offsets in standard deviations, then an increment per frame: one vector for a refiner.

    `height` is how tall the person is, metres; None where nobody has measured it.
    """

    character: Character
    seen: FramesSeen
    prior: ShapePrior
    height: Scalar | None = None

    @property
    def num_shared(self) -> int:
        """Unknowns that all frames share."""
        return 1 + len(LENGTHS) + len(GIRTHS) + 3 * len(OFFSETS)

    def start(self) -> Float[Array, "unknown"]:
        """Return the vector of the generic character in its base poses."""
        return jnp.zeros(self.num_shared + self.seen.base.angles.shape[0] * self.character.skeleton.num_dofs)

    def unknowns(self, vector: Float[Array, "unknown"]) -> Unknowns:
        """Split the vector into its parts in metres, radians and logarithms."""
        return self._named(*self._split(vector))

    def poses(self, unknowns: Unknowns, character: Character) -> Pose:
        """Compute the pose of every frame."""
        return jax.vmap(lambda pose, delta: retract(character.skeleton, pose, delta))(self.seen.base, unknowns.deltas)

    def residual(self, vector: Float[Array, "unknown"]) -> Float[Array, "row"]:
        """Compute the residual of keypoints, contours and posture of all frames, and of the height where it is known.

        The priors on the vector itself are left to the refiner.
        """
        shared, deltas = self._split(vector)
        parts = [
            jax.vmap(rows, in_axes=(None, 0, 0, 0))(shared, deltas[frames], base, seen).reshape(-1)
            for rows, frames, base, seen in self._blocks()
        ]
        return jnp.concatenate([*parts, self._height_row(shared)])

    def jacobian(self, vector: Float[Array, "unknown"]) -> Float[Array, "row unknown"]:
        """Differentiate the residual.

        A frame's rows depend on what all frames share and on its own pose, so a frame costs as much alone as among
        others.
        """
        shared, deltas = self._split(vector)
        parts = []
        for rows, frames, base, seen in self._blocks():
            slopes = jax.vmap(jax.jacfwd(rows, argnums=(0, 1)), in_axes=(None, 0, 0, 0))
            by_shared, by_own = slopes(shared, deltas[frames], base, seen)
            count, height, _ = by_own.shape
            spread = jnp.zeros((count, height, *deltas.shape)).at[np.arange(count), :, frames].set(by_own)
            parts.append(
                jnp.concatenate([by_shared, spread.reshape(count, height, -1)], -1).reshape(count * height, -1)
            )
        last = jax.jacfwd(self._height_row)(shared)
        return jnp.concatenate([*parts, jnp.pad(last, ((0, 0), (0, deltas.size)))])

    def _split(self, vector: Float[Array, "unknown"]) -> tuple[Float[Array, "shared"], Float[Array, "frame dof"]]:
        shared, deltas = jnp.split(vector, [self.num_shared])
        return shared, deltas.reshape(-1, self.character.skeleton.num_dofs)

    def _named(self, shared: Float[Array, "shared"], deltas: Float[Array, "frame dof"]) -> Unknowns:
        prior = self.prior
        height, lengths, girths, offsets = jnp.split(shared, np.cumsum([1, len(LENGTHS), len(GIRTHS)]))
        least = np.isin(LENGTHS, ("head", "hand", "foot"))
        lengths = jnp.where(least, prior.extremity, prior.length) * lengths
        girths = prior.coupling * jnp.matmul(_coupling(), lengths, precision="highest") + prior.girth * girths
        shape = BodyShape(prior.height * height[0], lengths, girths)
        return Unknowns(shape, prior.offset * offsets.reshape(-1, 3), deltas)

    def _blocks(self) -> list[tuple[Callable[..., Array], np.ndarray, Pose, Any]]:
        """Kinds of rows: a function of what is shared, a frame's increment, its base and what is seen of it; and the
        frames that have them."""
        every = np.arange(self.seen.base.angles.shape[0])
        blocks: list[tuple[Callable[..., Array], np.ndarray, Pose, Any]] = [
            (self._keypoint_rows, every, self.seen.base, self.seen.rays)
        ]
        if self.seen.contours is not None:
            frames = np.array(self.seen.outlined)
            blocks.append(
                (self._contour_rows, frames, jax.tree.map(lambda x: x[frames], self.seen.base), self.seen.contours)
            )
        return blocks

    def _keypoint_rows(self, shared: Array, delta: Array, base: Pose, seen: LandmarkRays) -> Float[Array, "row"]:
        unknowns = self._named(shared, delta[None])
        skeleton = scaled(self.character, unknowns.shape).skeleton
        pose = retract(skeleton, base, delta)
        points = detector_points(skeleton, pose, unknowns.offsets)
        return jnp.concatenate([seen.of(points).reshape(-1), bend(skeleton, pose.angles) / self.prior.posture])

    def _contour_rows(
        self, shared: Array, delta: Array, base: Pose, seen: tuple[SurfaceLines, Array, Array]
    ) -> Float[Array, "row"]:
        character = scaled(self.character, self._named(shared, delta[None]).shape)
        return LineResidual(character, base, *seen)(delta)

    def _height_row(self, shared: Float[Array, "shared"]) -> Float[Array, "row"]:
        if self.height is None:
            return jnp.zeros(0)
        character = scaled(self.character, self._named(shared, jnp.zeros((0, self.character.skeleton.num_dofs))).shape)
        return jnp.log(stature(character) / self.height)[None] / self.prior.measured

    def refine_problem(self) -> RefineProblem:
        """Express the priors as a box and a pull towards zero, and the joint limits."""
        skeleton, base, frames = self.character.skeleton, self.seen.base, self.seen.base.angles.shape[0]
        far = jnp.full((frames, ROOT_DOFS), 20.0)
        shared = jnp.full(self.num_shared, self.prior.widest)
        lower = jnp.concatenate([-far, skeleton.lower - base.angles], 1).reshape(-1)
        upper = jnp.concatenate([far, skeleton.upper - base.angles], 1).reshape(-1)
        pull = jnp.tile(
            jnp.concatenate([jnp.full(ROOT_DOFS, 1e-4), jnp.full(skeleton.num_angles, self.prior.angle**-2)]), frames
        )
        return RefineProblem(
            residual=self.residual,
            jacobian=self.jacobian,
            prior=jnp.zeros(self.num_shared + frames * skeleton.num_dofs),
            lower=jnp.concatenate([-shared, lower]),
            upper=jnp.concatenate([shared, upper]),
            l1=jnp.asarray(0.0),
            prior_weight=jnp.concatenate([jnp.ones(self.num_shared), pull]),
        )


@eqx.filter_jit
def solve(problem: ShapeProblem, start: Float[Array, "unknown"], refiner: AbstractRefiner) -> Float[Array, "unknown"]:
    """Solve for the best vector from a start."""
    return refiner.refine(problem.refine_problem(), start).value


def detector_points(skeleton: Skeleton, pose: Pose, offsets: Float[Array, "offset 3"]) -> Float[Array, "landmark 3"]:
    """Place the landmarks where the detector sees them, world, metres.

    Offsets are those of the left side, in the rest frame.
    """
    rows, bodies, numbers, mirror = _offset_rows(skeleton)
    rotations = body_transforms(skeleton, pose)[bodies, :3, :3]
    shift = jnp.sum(rotations * (mirror * offsets[numbers])[:, None, :], axis=-1)
    return landmark_positions(skeleton, pose).at[rows].add(shift)


def _offset_rows(skeleton: Skeleton) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Landmark, carrying body, number of the offset and its mirroring, of every landmark that has an offset."""
    rows, bodies = [], carriers(skeleton)
    for number, point in enumerate(OFFSETS):
        for side, sign in (("l_", 1.0), ("r_", -1.0)) if point != "nose" else (("", 0.0),):
            row = skeleton.landmark_names.index(side + point)
            rows.append((row, bodies[row], number, (sign, 1.0, 1.0)))
    landmark, body, number, mirror = zip(*rows, strict=True)
    return np.array(landmark), np.array(body), np.array(number), np.array(mirror, np.float32)


def _coupling() -> Float[np.ndarray, "girth length"]:
    table = np.zeros((len(GIRTHS), len(LENGTHS)), np.float32)
    for row, name in enumerate(GIRTHS):
        for bone in _COUPLED[name]:
            table[row, LENGTHS.index(bone)] = 1 / len(_COUPLED[name])
    return table
