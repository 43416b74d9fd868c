"""Where the person may stand when only one view shows the keypoints: starts for the inverse kinematics.

One view leaves each bone two directions, towards the camera or away from it, and depth follows from the size of the
body alone. So the person is put at the depth at which the longest bones look as long as they are, upright along the
trunk that the view shows, and turned to all sides; joint limits, the wish for small angles, and the sides that hips and
shoulders show do the rest.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxmocap.camera import View
from jaxmocap.character import Character, Pose, Skeleton

TRUNK = (2, 5, 9, 12)
"""Keypoints that must be seen: right and left shoulder, right and left hip."""

LEAST_POINTS = 8
SIDES = 16
_BONES = (
    (2, "r_shoulder", 9, "r_hip"),
    (5, "l_shoulder", 12, "l_hip"),
    (2, "r_shoulder", 3, "r_elbow"),
    (3, "r_elbow", 4, "r_wrist"),
    (5, "l_shoulder", 6, "l_elbow"),
    (6, "l_elbow", 7, "l_wrist"),
    (9, "r_hip", 10, "r_knee"),
    (10, "r_knee", 11, "r_ankle"),
    (12, "l_hip", 13, "l_knee"),
    (13, "l_knee", 14, "l_ankle"),
)


_IN_PLANE = 0.8
"""Quantile of the bones' apparent lengths that is taken for a bone seen from its side."""


def _axes(left: np.ndarray, up: np.ndarray) -> Float[np.ndarray, "3 3"]:
    y = up / np.linalg.norm(up)
    x = left - (left @ y) * y
    x /= np.linalg.norm(x)
    return np.stack([x, y, np.cross(x, y)], 1)


def body_axes(
    left_shoulder: np.ndarray, right_shoulder: np.ndarray, left_hip: np.ndarray, right_hip: np.ndarray
) -> Float[np.ndarray, "3 3"]:
    """Compute the axes of a trunk as columns: to its left, up, ahead."""
    left = left_shoulder - right_shoulder + left_hip - right_hip
    return _axes(left, left_shoulder + right_shoulder - left_hip - right_hip)


def rest_trunk(skeleton: Skeleton) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3"]]:
    """Compute `body_axes` of the rest pose, and the middle of its hips."""
    at = [np.asarray(skeleton.landmark(name)) for name in ("l_shoulder", "r_shoulder", "l_hip", "r_hip")]
    return body_axes(*at), 0.5 * (at[2] + at[3])


def best_view(keypoints: list[Float[np.ndarray, "25 3"] | None]) -> int | None:
    """Choose the view that shows most points, if it shows the trunk and `LEAST_POINTS`."""
    seen = [np.zeros(25, bool) if points is None else points[:, 2] > 0 for points in keypoints]
    shown = [int(points.sum()) if points[list(TRUNK)].all() else 0 for points in seen]
    best = int(np.argmax(shown))
    return best if shown[best] >= LEAST_POINTS else None


def single_view_starts(character: Character, view: View, camera: int, points: Float[np.ndarray, "25 3"]) -> list[Pose]:
    """Stand bodies upright at the depth that the view suggests, turned to `SIDES` sides."""
    skeleton = character.skeleton
    intrinsics, cam_from_world = np.asarray(view.intrinsics[camera]), np.asarray(view.cam_from_world[camera])
    pixels, focal = points[:, :2], float(intrinsics[1, 1])
    apparent = [
        np.linalg.norm(pixels[a] - pixels[b]) / np.linalg.norm(np.asarray(skeleton.landmark(u) - skeleton.landmark(v)))
        for a, u, b, v in _BONES
        if points[a, 2] > 0 and points[b, 2] > 0
    ]
    depth = focal / max(float(np.quantile(apparent, _IN_PLANE)), 1e-3)
    hips = 0.5 * (pixels[9] + pixels[12])
    ray = np.linalg.solve(intrinsics, np.append(hips, 1.0))
    trunk = 0.5 * (pixels[2] + pixels[5]) - hips
    up = np.append(trunk if np.linalg.norm(trunk) > 1 else [0.0, -1.0], 0.0)
    rest_axes, rest_hips = rest_trunk(skeleton)
    world_from_cam = cam_from_world[:3, :3].T
    place = world_from_cam @ (ray / ray[2] * depth - cam_from_world[:3, 3])
    away = np.array([0.0, 0.0, 1.0])
    across, starts = np.cross(away, up / np.linalg.norm(up)), []
    for angle in np.linspace(0, 2 * np.pi, SIDES, endpoint=False):
        left = np.cos(angle) * across + np.sin(angle) * away
        rotation = world_from_cam @ _axes(left, up) @ rest_axes.T
        root = np.eye(4, dtype=np.float32)
        root[:3, :3], root[:3, 3] = rotation, place - rotation @ rest_hips
        starts.append(Pose(jnp.asarray(root), jnp.zeros(skeleton.num_angles)))
    return starts
