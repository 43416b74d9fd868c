"""From a detector's keypoints in pictures of a mesh to about where its joints are.

Two views or more are triangulated. Lines of sight of level cameras meet even if the detector took left for right in one
of them, so pairs of views are held against the mesh: a joint lies about in the middle of a limb. What one view alone
shows is taken to be there.
"""

from collections.abc import Mapping
from itertools import combinations
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from jaxmocap.camera import View, pixel_rays, project, triangulate
from jaxmocap.observation import BODY_25

from ._mesh_rays import Crossing, cross
from ._pins import Pin

JOINTS = {
    number: {("l_shoulder", "r_shoulder"): "mid_shoulder", ("l_hip", "r_hip"): "mid_hip"}.get(parts, parts[0])
    for number, parts in BODY_25.items()
    if parts[0].endswith(("shoulder", "elbow", "wrist", "hip", "knee", "ankle"))
}
"""The points of BODY_25 that are joints, and which."""

UNSURE = 0.1  # confidence below which a detector has guessed
_NOISE, _ALONG = 0.03, 0.08  # metres, a detector's standard deviation across a ray, and that of the middle of a limb
_FAR = 0.1  # metres from a ray, or from the middle of a limb, that speak against a point


class Seen(NamedTuple):
    """Keypoints in all views of a mesh whose largest extent is the template's height: `points` (camera, 25, 3) hold
    pixels and confidence, and `crossings` what of the mesh each ray passes, by camera and number of the point."""

    view: View
    points: Float[np.ndarray, "camera 25 3"]
    crossings: Mapping[tuple[int, int], Crossing]


def look(
    view: View,
    points: Float[np.ndarray, "camera 25 3"],
    vertices: Float[np.ndarray, "vertex 3"],
    faces: Int[np.ndarray, "face 3"],
) -> Seen:
    """Follow every joint that is seen with some confidence into the mesh."""
    centres, directions = pixel_rays(view.intrinsics, view.cam_from_world, jnp.asarray(points[..., :2], jnp.float32))
    centres, directions = np.asarray(centres, np.float64), np.asarray(directions, np.float64)
    crossings = {
        (camera, number): cross(vertices, faces, centres[camera], directions[camera, number])
        for camera in range(len(points))
        for number in JOINTS
        if points[camera, number, 2] >= UNSURE
    }
    return Seen(view, points, crossings)


def joint_pins(seen: Seen) -> dict[str, Pin]:
    """Where the joints are about, metres; those that no view shows are left out."""
    pairs = {
        pair: _triangulated(seen, pair)
        for size in range(2, len(seen.points) + 1)
        for pair in combinations(range(len(seen.points)), size)
    }
    pins = {}
    for number, name in JOINTS.items():
        cameras = [camera for camera in range(len(seen.points)) if (camera, number) in seen.crossings]
        candidates: dict[tuple[int, ...], np.ndarray] = {
            (camera,): seen.crossings[camera, number].middle for camera in cameras
        }
        candidates |= {
            pair: points[number]
            for pair, points in pairs.items()
            if set(pair) <= set(cameras) and np.all(np.isfinite(points[number]))
        }
        if candidates:
            chosen = min(candidates, key=lambda of: _doubts(seen, number, cameras, of, candidates[of]))
            pins[name] = Pin(candidates[chosen], _information(seen, number, chosen), doubted=True)
    return pins


def _triangulated(seen: Seen, cameras: tuple[int, ...]) -> np.ndarray:
    chosen = list(cameras)
    view = View(seen.view.intrinsics[jnp.array(chosen)], seen.view.cam_from_world[jnp.array(chosen)])
    points = jnp.asarray(seen.points[chosen], jnp.float32)
    weights = jnp.where(points[..., 2] >= UNSURE, points[..., 2], 0.0)
    return np.asarray(triangulate(view, points[..., :2], weights), np.float64)


def _doubts(seen: Seen, number: int, cameras: list[int], of: tuple[int, ...], place: np.ndarray) -> float:
    """What speaks against a place: views that see the joint elsewhere, and no limb around it. Views agree the better
    the more they are."""
    off = [min(_across(seen, camera, number, place) / _FAR, 1.0) ** 2 for camera in cameras]
    beside = min(float(np.linalg.norm(seen.crossings[camera, number].middle - place)) for camera in of)
    unsure = 0.1 * (1.0 - float(np.mean([seen.points[camera, number, 2] for camera in of])))
    return sum(off) + min(beside / _FAR, 2.0) ** 2 - 0.3 * len(of) + unsure


def _across(seen: Seen, camera: int, number: int, place: np.ndarray) -> float:
    """How far a place is beside a camera's line of sight, metres."""
    pixel, depth = project(
        seen.view.intrinsics[camera], seen.view.cam_from_world[camera], jnp.asarray(place[None], jnp.float32)
    )
    focal = float(seen.view.intrinsics[camera, 0, 0])
    apart = np.linalg.norm(np.asarray(pixel[0]) - seen.points[camera, number, :2])
    return float(apart * abs(float(depth[0])) / focal)


def _information(seen: Seen, number: int, cameras: tuple[int, ...]) -> np.ndarray:
    """The inverse covariance: every ray tells across, a single one also that it ends about in the middle of a limb."""
    information = np.zeros((3, 3))
    for camera in cameras:
        pose = np.asarray(seen.view.cam_from_world[camera], np.float64)
        ray = seen.crossings[camera, number].middle + pose[:3, :3].T @ pose[:3, 3]
        ray = ray / np.linalg.norm(ray)
        sure = min(float(seen.points[camera, number, 2]), 1.0)
        information += sure * (np.eye(3) - np.outer(ray, ray)) / _NOISE**2
        if len(cameras) == 1:
            information += sure * np.outer(ray, ray) / _ALONG**2
    return information
