"""Where a frame begins (sec. 4.1, Initialization): from optical flow, or from whatever scores better."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxmocap.camera import Cameras
from jaxmocap.character import Character, Pose, clamp, difference, nearest_equivalent, retract, skin
from jaxmocap.motion import MotionHistory
from jaxmocap.observation import Frame, FrameImages, Observations, Rectangle, build_problem, frame_rectangle
from jaxmocap.refinement import FlowSettings, descend, detection_rays, follow_surface, free_prior, known_view
from jaxmocap.refiners import Shooting
from jaxmocap.search import PoseScore

from ._tracker import Tracker

FLOW_ROBUST = (0.08, 0.03)
"""Geman-McClure scales of the flow start's rounds, metres."""

ONTO_SCALE, ONTO_ROBUST, ONTO_STEPS = 0.02, 0.3, 8
"""The start from detections: metres that count as 1, Geman-McClure scale in metres, and steps."""


def flow_start(
    observations: Observations,
    settings: FlowSettings,
    rectangle: Rectangle | None,
    before: FrameImages,
    base: Pose,
    shown: FrameImages,
) -> tuple[Pose, Float[np.ndarray, "camera"]]:
    """Follow the points of the last frame's surface by optical flow (the paper's [4]): the pose they lead to, and the
    mean flow in pixels per view, which moves the rectangle.

    `before` are the images of the last frame, `base` its pose and `rectangle` its rectangle.
    """
    character, cameras = observations.character, observations.cameras
    vertices = np.asarray(skin(character, base))
    rectangle = frame_rectangle(vertices, cameras, shown.frame, rectangle)
    sources = [
        [known_view(character, cameras, image, before.frame, camera, base)]
        for camera, image in enumerate(before.images)
    ]
    problem = build_problem(shown.images, rectangle, cameras, shown.frame, vertices, observations.surface)
    frame = Frame(shown, rectangle, problem)
    pose, speed = base, np.zeros(len(shown.images))
    for round_index, robust in enumerate(FLOW_ROBUST):
        pose, _ = follow_surface(character, frame, sources, base, pose, settings, robust)
        if round_index == 0:
            speed = _pixel_speed(character, cameras, shown.frame, base, pose)
    return pose, speed


def _pixel_speed(
    character: Character, cameras: Cameras, frame: int, before: Pose, after: Pose
) -> Float[np.ndarray, "camera"]:
    view = cameras.at(frame)
    moved = np.linalg.norm(np.asarray(skin(character, after) - skin(character, before)), axis=1).mean()
    depth = np.asarray(skin(character, after)).mean(0)
    return np.array(
        [
            k[0, 0] * moved / max(float(t[2, :3] @ depth + t[2, 3]), 0.1)
            for k, t in zip(np.asarray(view.intrinsics), np.asarray(view.cam_from_world), strict=True)
        ]
    )


def best_start(
    score: PoseScore, tracker: Tracker, frame: Frame, flow: Pose, history: MotionHistory, registered: Pose | None
) -> Pose:
    """Choose the best start: the last pose, the flow start or the registered pose of a selected frame.

    With `prediction`, and with detections, its root, torso and limbs are moved one by one to where the last motion
    would lead, and to where the detections are, if that scores better.
    """
    character, problem = score.character, frame.problem
    skeleton = character.skeleton
    candidates = [history.pose, flow]
    if registered is not None:
        candidates.append(nearest_equivalent(skeleton, registered, history.pose))
    totals, _ = score(problem, candidates)
    best = int(np.argmin(totals))
    pose = candidates[best]
    if best == 2:
        return pose
    if tracker.prediction and history.increments:
        way = history.foreseen(frame.timestamp) * history.increments[-1]
        ahead = retract(skeleton, history.pose, jnp.asarray(way))
        pose = _towards(score, frame, pose, clamp(skeleton, ahead))
    if tracker.detections is not None and bool((problem.keypoints[..., 2] > 0).any()):
        pose = _towards(score, frame, pose, _onto_detections(character, frame, pose))
    return pose


def _towards(score: PoseScore, frame: Frame, pose: Pose, goal: Pose) -> Pose:
    """Move those parts of a pose, root, torso or limb, to the goal that then score better."""
    skeleton = score.character.skeleton
    step = np.asarray(difference(skeleton, pose, goal))
    parts = np.stack([np.isin(np.arange(skeleton.num_dofs), dofs) for _, dofs in skeleton.groups])
    moved = [retract(skeleton, pose, jnp.asarray(step * part)) for part in parts]
    totals, _ = score(frame.problem, [pose, *moved, goal])
    gained = parts[totals[1:-1] < totals[0]].any(0)
    both = retract(skeleton, pose, jnp.asarray(step * gained))
    candidates, last = [pose, *moved, goal, both], score(frame.problem, [both])[0]
    return candidates[int(np.argmin(np.append(totals, last)))]


def _onto_detections(character: Character, frame: Frame, pose: Pose) -> Pose:
    """Bring the pose to the detections' rays by a few steps of inverse kinematics."""
    skeleton = character.skeleton
    points = (detection_rays(skeleton, frame.problem, ONTO_SCALE, ONTO_ROBUST),)
    prior = free_prior(character, pose, 0.05)
    start = jnp.zeros(skeleton.num_dofs)
    delta, _ = descend(character, pose, start, (), points, prior, Shooting(), steps=ONTO_STEPS)
    return retract(skeleton, pose, delta)
