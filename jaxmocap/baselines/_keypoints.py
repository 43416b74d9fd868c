"""Keypoint triangulation and inverse kinematics: what markerless tools built on a detector do."""

from dataclasses import dataclass

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from jaxmocap._results import InputError
from jaxmocap.capture import Capture
from jaxmocap.character import Character, Pose, clamp, landmark_positions, retract
from jaxmocap.motion import MotionHistory
from jaxmocap.observation import BODY_25, Frame, Observations
from jaxmocap.refinement import descend, free_prior
from jaxmocap.refiners import Shooting
from jaxmocap.registration import triangulated

from ._follower import Baseline, Follower

_SCALE, _ROBUST = 0.02, 0.15
"""Metres that count as 1, and the Geman-McClure scale beyond which a point is taken for wrong."""


def asked_for_keypoints(observations: Observations, needed_by: str) -> Observations:
    """Return the observations if they hold detections. Raises `InputError` where they do not."""
    if observations.detections is None:
        raise without_keypoints(observations.capture, needed_by)
    return observations


def without_keypoints(capture: Capture, needed_by: str) -> InputError:
    """Say that a capture has no keypoints at every frame, and what to do."""
    return InputError(
        f"capture '{capture.name}' comes without keypoints at every frame, which {needed_by} needs; find them with "
        "jaxmocap detect, or give observe a folder of them as detections."
    )


class LandmarkPoints(eqx.Module):
    """Landmarks tied to points in the world, as rows of the least squares like `LandmarkRays`: `mix (row, landmark)`
    averages landmarks; metres."""

    mix: Float[Array, "row landmark"]
    points: Float[Array, "row 3"]
    weight: Float[Array, "row"]

    def __call__(self, character: Character, pose: Pose) -> Float[Array, "rows"]:
        landmarks = landmark_positions(character.skeleton, pose)
        error = jnp.matmul(self.mix, landmarks, precision="highest") - self.points
        square = jnp.sum(error**2, axis=-1) / _ROBUST**2
        return (error * (jnp.sqrt(self.weight) / jnp.sqrt(1.0 + square) / _SCALE)[:, None]).reshape(-1)


@dataclass(frozen=True)
class KeypointTriangulation(Baseline):
    """Every keypoint that two views show is triangulated by itself (linear, weighed by confidence), then the skeleton
    is fitted to the points by least squares with joint limits, from the last pose. No pixel is looked at.

    Needs observations with `detections`.

    Attributes:
        least: points below which a frame keeps the last pose; 4.
        smoothness: weight of the pull to the last pose, in units of the residual per radian, squared; 0.02.
        steps: of least squares; 12.
    """

    least: int = 4
    smoothness: float = 0.02
    steps: int = 12

    name = "keypoint triangulation"

    def follow(self, observations: Observations, key: PRNGKeyArray) -> Follower:
        """Make the worker of one sequence. Raises `InputError` where the observations hold no detections."""
        return super().follow(asked_for_keypoints(observations, "keypoint triangulation"), key)

    def start(self, worker: Follower, history: MotionHistory, timestamp: float) -> Pose:
        """Begin at the last pose: where depth is weak, extrapolating noise would run away."""
        return history.pose

    def find(self, worker: Follower, frame: Frame, start: Pose) -> Pose:
        skeleton = worker.character.skeleton
        keypoints = np.asarray(frame.problem.keypoints, np.float64)
        points, known = triangulated(worker.cameras.at(frame.number), list(keypoints))
        names = skeleton.landmark_names
        rows = [index for index, parts in BODY_25.items() if known[index] and all(part in names for part in parts)]
        if len(rows) < self.least:
            return start
        table = list(BODY_25)  # one row per point of the table, so that frames share a program
        mix = np.array([[BODY_25[i].count(n) / len(BODY_25[i]) for n in names] for i in table], np.float32)
        seen = np.where(keypoints[..., 2] > 0, keypoints[..., 2], np.inf).min(axis=0)  # the least of those that see it
        weight = np.array([seen[i] if i in rows else 0.0 for i in table], np.float32)
        target = np.where(weight[:, None] > 0, points[table], 0.0).astype(np.float32)
        landmarks = LandmarkPoints(jnp.asarray(mix), jnp.asarray(target), jnp.asarray(weight))
        prior = free_prior(worker.character, start, self.smoothness)
        delta, _ = descend(
            worker.character,
            start,
            jnp.zeros(worker.character.skeleton.num_dofs),
            (),
            (landmarks,),
            prior,
            Shooting(),
            steps=self.steps,
        )
        return clamp(skeleton, retract(skeleton, start, delta))
