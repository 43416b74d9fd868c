"""Terms that look at the pose itself: the rays of a detector's keypoints, and how far the trunk is bent."""

from collections.abc import Mapping
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from jaxmocap._types import Knob, knob
from jaxmocap.character import ROOT_DOFS, Character, Pose, Skeleton, offset_landmarks
from jaxmocap.observation import BODY_25, FACE, FrameProblem, carriers

from ._body import GroupProblem
from ._lines import rays
from ._term import AbstractPoseTerm, Drawn

LOOSE = {1: 0.03, 8: 0.1, 19: 0.3, 21: 0.3, 22: 0.3, 24: 0.3}
"""Points whose definition differs between a detector and a skeleton count less."""

NOSE = 0
"""Of BODY_25; with `FACE` it says where the head looks."""


class LandmarkRays(eqx.Module):
    """Landmarks tied to the rays of 2D keypoints: `mix (row, landmark)` averages landmarks (the neck keypoint is the
    middle of the shoulders), which the detector sees `offsets` away, metres in the rest frame of `carriers`.
    `scale` and `robust` in metres; rows of weight 0 are points that were not found."""

    mix: Float[Array, "row landmark"]
    offsets: Float[Array, "landmark 3"]
    direction: Float[Array, "row 3"]
    moment: Float[Array, "row 3"]
    weight: Float[Array, "row"]
    scale: Float[Array, ""]
    robust: Float[Array, ""]
    carriers: tuple[int, ...] = eqx.field(static=True)

    def __call__(self, character: Character, pose: Pose) -> Float[Array, "rows"]:
        return self.of(self.landmarks(character.skeleton, pose))

    def landmarks(self, skeleton: Skeleton, pose: Pose) -> Float[Array, "landmark 3"]:
        """Place the landmarks where the detector sees them, in the world."""
        return offset_landmarks(skeleton, pose, self.offsets, self.carriers)

    def of(self, landmarks: Float[Array, "landmark 3"]) -> Float[Array, "rows"]:
        """Compute the residual of landmarks that stand here, in the world."""
        error = self.distances(landmarks)
        square = jnp.sum(error**2, axis=-1) / self.robust**2
        return (error * (jnp.sqrt(self.weight) * lax.rsqrt(1.0 + square) / self.scale)[:, None]).reshape(-1)

    def distances(self, landmarks: Float[Array, "landmark 3"]) -> Float[Array, "row 3"]:
        """Compute vectors as long as the distance from each row's point to its ray, metres, unweighted."""
        points = jnp.matmul(self.mix, landmarks, precision="highest")
        return jnp.cross(points, self.direction) - self.moment


def keypoint_rays(
    skeleton: Skeleton,
    intrinsics: Float[Array, "camera 3 3"],
    cam_from_world: Float[Array, "camera 4 4"],
    keypoints: Float[Array, "camera 25 3"],
    scale: float | Array = 0.02,
    robust: float | Array = 0.1,
    table: Mapping[int, tuple[str, ...]] = BODY_25,
    offsets: Float[Array, "25 3"] | None = None,
    face: float = 0.3,
) -> LandmarkRays:
    """Build a row for every keypoint of `table` in every view.

    x, y are pixels of the undistorted image, the third number is the detector's confidence and weighs the row (0: not
    found). `scale` metres count as 1, beyond `robust` metres a point fades. `offsets` lead from a point's landmark to
    where the detector sees it (default: nowhere); a point between two landmarks has the mean of theirs. `face` weighs
    nose, eyes and ears, whose places differ between a detector and a skeleton. Points whose landmarks the skeleton does
    not have are left out.
    """
    names = skeleton.landmark_names
    known = {index: parts for index, parts in table.items() if all(part in names for part in parts)}
    mix = np.array([[parts.count(name) / len(parts) for name in names] for parts in known.values()], np.float32)
    index = np.array(list(known))
    weights = LOOSE | dict.fromkeys((NOSE, *FACE), face)
    loose = jnp.array([weights.get(point, 1.0) for point in known])
    single = {parts[0]: point for point, parts in known.items() if len(parts) == 1}
    shift = jnp.zeros((len(names), 3))
    if offsets is not None and single:
        shift = shift.at[np.array([names.index(name) for name in single])].set(offsets[np.array(list(single.values()))])
    cameras = keypoints.shape[0]
    lines = [rays(intrinsics[c], cam_from_world[c], keypoints[c, index, :2]) for c in range(cameras)]
    return LandmarkRays(
        jnp.tile(jnp.asarray(mix), (cameras, 1)),
        shift,
        jnp.concatenate([direction for _, direction, _ in lines]),
        jnp.concatenate([moment for _, _, moment in lines]),
        (jnp.maximum(keypoints[:, index, 2], 0.0) * loose).reshape(-1),
        jnp.asarray(scale, jnp.float32),
        jnp.asarray(robust, jnp.float32),
        carriers(skeleton),
    )


class Keypoints(AbstractPoseTerm):
    """How far landmarks are from the rays of the frame's detections, each faded by Geman and McClure beyond `robust`
    metres and weighed by its confidence; the mean over all views and points there could be, in [0, 1], so that a frame
    with few detections is judged by its pixels. The paper names this as future work.

    Attributes:
        weight: of the term, beside those of Eq. 5; 1.
        robust: metres beyond which a landmark's distance hardly counts more; 0.1.
    """

    weight: Knob = knob(1.0)
    robust: Knob = knob(0.1)

    name: ClassVar[str] = "keypoints"

    def prepare(self, base: Array, group: GroupProblem) -> LandmarkRays:
        """Cast the rays once for all particles."""
        return self._rays(group.character.skeleton, group.frame)

    def score(self, prepared: LandmarkRays, drawn: Drawn, group: GroupProblem) -> Float[Array, ""]:
        return self._mean(prepared, group.character.skeleton, drawn.pose)

    def score_pose(self, skeleton: Skeleton, pose: Pose, frame: FrameProblem) -> Float[Array, ""]:
        return self._mean(self._rays(skeleton, frame), skeleton, pose)

    def _rays(self, skeleton: Skeleton, frame: FrameProblem) -> LandmarkRays:
        return keypoint_rays(
            skeleton,
            frame.intrinsics,
            frame.cam_from_world,
            frame.keypoints,
            table=BODY_25 | FACE,
            offsets=frame.keypoint_offsets,
        )

    def _mean(self, lines: LandmarkRays, skeleton: Skeleton, pose: Pose) -> Float[Array, ""]:
        square = jnp.sum(lines.distances(lines.landmarks(skeleton, pose)) ** 2, -1)
        return jnp.mean(lines.weight * square / (square + self.robust**2))


def bend(skeleton: Skeleton, angles: Float[Array, "... angle"]) -> Float[Array, "... angle"]:
    """Divide angles of spine, neck and collar bones by their limits on the side they bend to; 0 for all others."""
    counts = jnp.asarray(np.isin(np.arange(ROOT_DOFS, skeleton.num_dofs), skeleton.posture).astype(np.float32))
    limit = jnp.where(angles >= 0, skeleton.upper, -skeleton.lower)
    return counts * angles / jnp.maximum(limit, 0.1)


class Posture(AbstractPoseTerm):
    """The sum of squared shares of their limits to which spine, neck and collar bones are bent. Not in the paper,
    whose search may explain a pixel by any posture within the limits; without this term in the energy it is back.

    Attributes:
        weight: of the term, beside those of Eq. 5; 0.005.
    """

    weight: Knob = knob(0.005)

    name: ClassVar[str] = "posture"

    def score_pose(self, skeleton: Skeleton, pose: Pose, frame: FrameProblem) -> Float[Array, ""]:
        return jnp.sum(bend(skeleton, pose.angles) ** 2)
