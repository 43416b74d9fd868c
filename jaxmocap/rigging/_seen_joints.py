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

from ._fit_template import Pin

_MANY = 50_000  # triangles at a time


class Crossing(NamedTuple):
    """A ray and a mesh: the point of the ray in the `middle` of the first limb it passes, or beside the part of the
    mesh that it misses least, and how far it misses (0 where it hits)."""

    middle: Float[np.ndarray, "3"]
    miss: float


def cross(
    vertices: Float[np.ndarray, "vertex 3"],
    faces: Int[np.ndarray, "face 3"],
    centre: Float[np.ndarray, "3"],
    direction: Float[np.ndarray, "3"],
) -> Crossing:
    """Pass a ray (a unit `direction` from `centre`) through a mesh, closed or not, in whatever units."""
    depths = _hits(vertices, faces, centre, direction)
    if len(depths):
        leaves = depths[1] if len(depths) > 1 else depths[0]
        return Crossing(centre + 0.5 * (depths[0] + leaves) * direction, 0.0)
    off = vertices - centre
    along = off @ direction
    apart = np.linalg.norm(off - along[:, None] * direction, axis=1)
    nearest = int(np.argmin(np.where(along > 0, apart, np.inf)))
    return Crossing(centre + along[nearest] * direction, float(apart[nearest]))


def _hits(vertices: np.ndarray, faces: np.ndarray, centre: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Sorted depths at which the ray meets the surface, an edge that two triangles share only once."""
    found = []
    for start in range(0, len(faces), _MANY):
        a, b, c = (vertices[faces[start : start + _MANY, corner]] for corner in range(3))
        ab, ac, off = b - a, c - a, centre - a
        across = np.cross(direction, ac)
        volume = np.einsum("fi,fi->f", ab, across)
        with np.errstate(divide="ignore", invalid="ignore"):
            u = np.einsum("fi,fi->f", off, across) / volume
            normal = np.cross(off, ab)
            v = normal @ direction / volume
            depth = np.einsum("fi,fi->f", ac, normal) / volume
            inside = (u >= 0) & (v >= 0) & (u + v <= 1) & (depth > 0)
        found.append(depth[inside])
    depths = np.sort(np.concatenate(found))
    same = 1e-6 * np.ptp(vertices, axis=0).max()
    return depths[np.diff(depths, prepend=-np.inf) > same]


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
    """Estimate where the joints are, metres; those that no view shows are left out."""
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
    """Add up what speaks against a place: views that see the joint elsewhere, and no limb around it.

    Views agree the better the more they are.
    """
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
    """Build the inverse covariance of a joint's place.

    Every ray tells where it is across the ray; a single ray also that it ends about in the middle of a limb.
    """
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
