"""A detector's 2D keypoints: what they mean on our skeleton, and which of several people is ours."""

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxmocap.camera import View, project
from jaxmocap.character import Character, Pose, Skeleton, body_transforms, landmark_positions

BODY_25 = {
    0: ("nose",),
    1: ("l_shoulder", "r_shoulder"),
    2: ("r_shoulder",),
    3: ("r_elbow",),
    4: ("r_wrist",),
    5: ("l_shoulder",),
    6: ("l_elbow",),
    7: ("l_wrist",),
    8: ("l_hip", "r_hip"),
    9: ("r_hip",),
    10: ("r_knee",),
    11: ("r_ankle",),
    12: ("l_hip",),
    13: ("l_knee",),
    14: ("l_ankle",),
    19: ("l_toe",),
    21: ("l_heel",),
    22: ("r_toe",),
    24: ("r_heel",),
}
"""Which landmarks, averaged, an OpenPose BODY_25 point is."""

FACE = {15: ("r_eye",), 16: ("l_eye",), 17: ("r_ear",), 18: ("l_ear",)}
"""The points of BODY_25 that say where the head looks."""

FARTHEST = 0.35
"""A person whose points lie farther than this share of our person's height from where they are expected (median) is
somebody else."""

CARRIERS = {"shoulder": "clavicle", "hip": "pelvis"}
"""Bodies with which the places move where a detector sees these joints, which turn the upper arm and the thigh."""

OFFSET_ROBUST = 0.05
"""Geman-McClure scale of what a frame tells of the detector's offsets, metres."""


def stacked_keypoints(keypoints: Sequence[Float[np.ndarray, "25 3"] | None]) -> Float[np.ndarray, "camera 25 3"]:
    """Stack the keypoints of all views in one array; a view without a person has confidence 0 everywhere."""
    return np.stack([np.zeros((25, 3)) if points is None else points for points in keypoints]).astype(np.float32)


def expected_keypoints(character: Character, pose: Pose, view: View) -> Float[np.ndarray, "camera 25 2"]:
    """Predict where a detector should see the points of `BODY_25`, in pixels; NaN for those not in it."""
    names = character.skeleton.landmark_names
    places = np.asarray(landmark_positions(character.skeleton, pose))
    points = np.full((view.intrinsics.shape[0], 25, 2), np.nan)
    known = {index: parts for index, parts in BODY_25.items() if all(part in names for part in parts)}
    means = np.stack([places[[names.index(part) for part in parts]].mean(0) for parts in known.values()])
    for camera in range(len(points)):
        pixels, _ = project(view.intrinsics[camera], view.cam_from_world[camera], jnp.asarray(means, jnp.float32))
        points[camera, list(known)] = np.asarray(pixels)
    return points


def nearest_person(
    people: Sequence[Float[np.ndarray, "25 3"]], expected: Float[np.ndarray, "25 2"]
) -> Float[np.ndarray, "25 3"] | None:
    """Find the person whose points lie nearest to the expected ones in the median; None when nobody is near enough."""
    best, found = FARTHEST * float(np.ptp(expected[np.isfinite(expected[:, 1]), 1], axis=0)), None
    for points in people:
        distance = np.linalg.norm(points[:, :2] - expected, axis=1)[(points[:, 2] > 0) & np.isfinite(expected[:, 0])]
        if distance.size and np.median(distance) < best:
            best, found = float(np.median(distance)), points
    return found


def carriers(skeleton: Skeleton) -> tuple[int, ...]:
    """List for every landmark the body with which a detector's offset from it moves: its own, or that of `CARRIERS`."""
    bodies = list(skeleton.landmark_bodies)
    for row, name in enumerate(skeleton.landmark_names):
        side, _, joint = name.rpartition("_")
        carrier = CARRIERS.get(joint, "")
        for body in (carrier, f"{side}_{carrier}"):
            if body in skeleton.body_names:
                bodies[row] = skeleton.body_names.index(body)
    return tuple(bodies)


class DetectorOffsets(NamedTuple):
    """What frames have told of where a detector sees the landmarks: its hips are not the centres of the hip joints.

    One offset per point, in the rest frame of the body that carries it (`carriers`), by linear least squares over the
    rays of all views and frames: `square` is the matrix of the normal equations, `slope` their right side. Only points
    that are one landmark have one.
    """

    square: Float[np.ndarray, "25 3 3"]
    slope: Float[np.ndarray, "25 3"]

    @staticmethod
    def start() -> "DetectorOffsets":
        """Know nothing: every offset is 0, as sure as one ray makes it."""
        return DetectorOffsets(np.tile(np.eye(3), (25, 1, 1)), np.zeros((25, 3)))

    def learn(
        self, skeleton: Skeleton, pose: Pose, view: View, keypoints: Float[np.ndarray, "camera 25 3"]
    ) -> "DetectorOffsets":
        """Learn from a frame whose pose is known. Points far off count little (Geman and McClure)."""
        names = skeleton.landmark_names
        single = {i: parts[0] for i, parts in (BODY_25 | FACE).items() if len(parts) == 1 and parts[0] in names}
        points, rows = list(single), [names.index(name) for name in single.values()]
        places = np.asarray(landmark_positions(skeleton, pose), np.float64)[rows]
        turned = np.asarray(body_transforms(skeleton, pose), np.float64)[
            [carriers(skeleton)[row] for row in rows], :3, :3
        ]
        known, square, slope = self.metres()[points], self.square.copy(), self.slope.copy()
        for seen, intrinsics, extrinsics in zip(keypoints, view.intrinsics, view.cam_from_world, strict=True):
            rotation, shift = np.asarray(extrinsics, np.float64)[:3, :3], np.asarray(extrinsics, np.float64)[:3, 3]
            pixels = np.append(seen[points, :2].astype(np.float64), np.ones((len(points), 1)), axis=1)
            ray = np.linalg.solve(np.asarray(intrinsics, np.float64), pixels.T).T @ rotation
            ray /= np.linalg.norm(ray, axis=1, keepdims=True)
            across = (np.eye(3) - ray[:, :, None] * ray[:, None, :]) @ turned  # an offset, seen along the ray
            off = -rotation.T @ shift - places
            off -= np.sum(ray * off, axis=1, keepdims=True) * ray
            far = np.sum((off - np.einsum("pij,pj->pi", across, known)) ** 2, axis=1)
            weight = np.maximum(seen[points, 2], 0) / (1 + far / OFFSET_ROBUST**2) ** 2
            square[points] += weight[:, None, None] * np.swapaxes(across, 1, 2) @ across
            slope[points] += weight[:, None] * np.einsum("pij,pi->pj", across, off)
        return DetectorOffsets(square, slope)

    def metres(self) -> Float[np.ndarray, "25 3"]:
        """Return the offsets."""
        return np.linalg.solve(self.square, self.slope[..., None])[..., 0]
