"""How the body moves from each frame to the next, as optical flow sees it: what single poses know nothing of."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Array, Float

from jaxmocap.character import Pose, skin
from jaxmocap.observation import Frame, FrameImages, Observations, build_problem, frame_rectangle
from jaxmocap.refinement import FOLLOWED_SCALE, FlowSettings, follow_surface, known_view

from ._system import body_points, point_covariances, point_places

ROBUST = (0.03, 0.01)
"""Geman-McClure scales of the rounds, metres."""

ROW = 0.01
"""Metres by which a pixel that is followed errs, standard deviation along one axis."""

LEAST = 0.0015
"""Metres by which a point errs however many pixels follow it."""


class FlowSteps(NamedTuple):
    """Tell how far the body's points (`body_points`) move from each frame to the next.

    Attributes:
        ways: metres in the world.
        covariance: of each, square metres; large where nothing is seen of what moves a point, and along lines of sight.
    """

    ways: Float[np.ndarray, "interval point 3"]
    covariance: Float[np.ndarray, "interval point 3 3"]


def flow_steps(
    observations: Observations,
    frames: range,
    poses: Pose,
    progress: Callable[[int, int], None] | None = None,
) -> FlowSteps:
    """Follow the surface by optical flow from each of `frames` to the next, the paper's [4], from poses that are known.

    `poses` are those of the frames, stacked; the smoother they are, the better: the picture of a frame is transferred
    over the surface into the next frame, and what flow sees beside that is what they have wrong. `frames` are positions
    in the span that all cameras share. `progress` hears how many are done, and of how many.
    """
    tell = progress or (lambda done, total: None)
    observations = observations.filled_up()
    skeleton = observations.character.skeleton
    points = body_points(skeleton)
    ways, ends, hessians = [], [], []
    last, rectangle = None, None
    for number, shown in enumerate(observations.frames(frames)):
        pose = Pose(poses.root[number], poses.angles[number])
        vertices = np.asarray(skin(observations.character, pose))
        rectangle = frame_rectangle(vertices, observations.cameras, shown.frame, rectangle)
        problem = build_problem(
            shown.images, rectangle, observations.cameras, shown.frame, vertices, observations.surface
        )
        if last is not None:
            moved, hessian = _step(observations, Frame(shown, rectangle, problem), *last, pose)
            here, there = (np.asarray(_places(skeleton, points, at), np.float64) for at in (last[1], moved))
            ways.append(there - here)
            ends.append(moved)
            hessians.append(np.asarray(hessian, np.float64))
        last = shown, pose
        tell(number + 1, len(frames))
    poses = jax.tree.map(lambda *leaves: jax.device_put(np.stack([np.asarray(leaf) for leaf in leaves])), *ends)
    open_still = (ROW / FOLLOWED_SCALE) ** 2 * point_covariances(skeleton, points, poses, np.array(hessians))
    return FlowSteps(np.array(ways), LEAST**2 * np.eye(3) + open_still)


_places = jax.jit(point_places)


def _step(
    observations: Observations, frame: Frame, before: FrameImages, base: Pose, pose: Pose
) -> tuple[Pose, Float[Array, "dof dof"]]:
    """Find the pose to which the surface goes from the pose `base` of the frame before, `pose` being about it."""
    character, cameras = observations.character, observations.cameras
    sources = [
        [known_view(character, cameras, image, before.frame, camera, base)]
        for camera, image in enumerate(before.images)
    ]
    hessian = None
    for robust in ROBUST:
        pose, hessian = follow_surface(character, frame, sources, base, pose, FlowSettings(), robust)
    assert hessian is not None
    return pose, hessian
