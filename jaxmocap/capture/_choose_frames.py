"""Selected frames (Gamma) chosen from the keypoints, when a capture names none."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from jaxmocap.camera import Cameras, project, triangulate

from ._capture import KEYPOINT_NAMES, Capture
from ._flash import lit_by_flash

DEFAULT_COUNT = 3
"""Of the paper's sequences: three selected frames for about two hundred."""

_POINTS = tuple(
    KEYPOINT_NAMES.index(name)
    for name in ("neck", *(f"{s}_{p}" for p in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle") for s in "lr"))
)
_NECK, _L_SHOULDER, _R_SHOULDER, _L_HIP, _R_HIP = 0, 1, 2, 7, 8
_TORSO = [_L_SHOULDER, _R_SHOULDER, _L_HIP, _R_HIP]
_CONFIDENT = 0.3
_WELL_SEEN = 11  # of the 13 points, in two views
_LARGEST_RESIDUAL = 0.1  # of the distance from hips to neck
_PLACEABLE = 3
_START = 0.05  # share of the capture
_LEAP = 0.15  # trunk lengths between neighbouring frames
_MOST_LIGHTS = 20  # frames whose light is looked at
_SIDE = 0.5  # trunk lengths of mean joint motion that turning a camera's direction by one radian is worth


class ChosenFrames(NamedTuple):
    """Positions of the frames, and why these, in a sentence."""

    frames: tuple[int, ...]
    reason: str


def choose_frames(
    capture: Capture, cameras: Cameras, count: int = DEFAULT_COUNT, within: tuple[int, int | None] = (0, None)
) -> ChosenFrames:
    """Choose at most `count` frames with good keypoints whose poses and sides seen stand for the whole capture.

    Good: the torso and 11 of 13 joints in two views, triangulated with less than a tenth of the trunk as residual, not
    leaping away from both neighbouring frames (detections gone astray), and not lit by a flash. Of these, one in the
    first twentieth of their span and then, one by one, the frame that brings all good frames nearest to a chosen one
    (facility location, greedily, which is within 1 - 1/e of the best; Nemhauser et al. 1978). Near means: joints about
    the trunk in its own axes, and the directions in which the cameras lie from it. Without good frames, the one that
    shows most points in two views; without any, the first. The same capture gives the same frames. With one camera
    joints are compared as they look in its image. Only frames `within` (first, end) are looked at and chosen.
    """
    if count < 1:
        raise ValueError(f"count is {count}; at least one frame must be chosen")
    views = "two views" if capture.num_cameras > 1 else "its view"
    shared = _frames_in_two_views(capture) if capture.num_cameras > 1 else capture.keypoint_frames(0)
    last = capture.num_frames if within[1] is None else within[1]
    shared = [frame for frame in shared if within[0] <= frame < last]
    poses, seen = {}, {}
    for frame in shared:
        if capture.num_cameras == 1:
            description, seen[frame] = _flat(capture, frame)
            if description is not None:
                poses[frame] = description
            continue
        points, residual, known = _triangulated(capture, cameras, frame)
        seen[frame] = int(known.sum())
        if known[_TORSO].all() and known.sum() >= _WELL_SEEN:
            description = _described(points, known, cameras, frame)
            if description is not None and residual <= _LARGEST_RESIDUAL * description.trunk:
                poses[frame] = description
    if poses:
        frames = tuple(poses)
        distance = _distances(list(poses.values()))
        steady = np.flatnonzero(~_leaps(distance, np.array(frames)))
        chosen = _in_usual_light(capture, distance[np.ix_(steady, steady)], np.array(frames)[steady], count)
        return ChosenFrames(
            tuple(sorted(chosen)),
            f"chosen for their poses and sides among {len(frames)} frames with good keypoints in {views}",
        )
    best = max(shared, key=lambda frame: (seen[frame], -frame), default=None)
    if best is not None and seen[best] >= _PLACEABLE:
        return ChosenFrames((best,), f"it shows the most keypoints in {views}, {seen[best]} of {len(_POINTS)}")
    return ChosenFrames((within[0],), f"no frame has three keypoints in {views}, so the first was taken")


def _in_usual_light(
    capture: Capture, distance: Float[np.ndarray, "frame frame"], frames: np.ndarray, count: int
) -> list[int]:
    """Choose frames by `facility_location`, and others where a flash lights the chosen ones."""
    usual: dict[int, bool] = {}
    left = np.arange(len(frames))
    while True:
        rows = left[facility_location(distance[np.ix_(left, left)], frames[left], count)]
        for row in rows:
            if row not in usual:
                usual[row] = len(usual) >= _MOST_LIGHTS or not lit_by_flash(capture, int(frames[row]))
        lit = [row for row in rows if not usual[row]]
        if not lit or len(lit) == len(left):
            return [int(frames[row]) for row in rows]
        left = np.setdiff1d(left, lit)


def _frames_in_two_views(capture: Capture) -> list[int]:
    frames = [frame for camera in range(capture.num_cameras) for frame in capture.keypoint_frames(camera)]
    values, counts = np.unique(np.array(frames, int), return_counts=True)
    return [int(frame) for frame in values[counts >= 2]]


def _triangulated(
    capture: Capture, cameras: Cameras, frame: int
) -> tuple[Float[np.ndarray, "13 3"], float, Bool[np.ndarray, "13"]]:
    """Triangulate the 13 points in the world.

    Returns with them the median distance of their rays to them in metres, and which are seen twice.
    """
    found = [capture.keypoints(camera, frame) for camera in range(capture.num_cameras)]
    rows = np.stack([np.zeros((25, 3)) if points is None else points for points in found])[:, _POINTS]
    weights = np.where(rows[..., 2] >= _CONFIDENT, rows[..., 2], 0.0)
    view = cameras.at(frame)
    points = triangulate(view, jnp.asarray(rows[..., :2], jnp.float32), jnp.asarray(weights, jnp.float32))
    known = ((weights > 0).sum(0) >= 2) & np.isfinite(np.asarray(points)).all(1)
    off = []
    for camera in range(capture.num_cameras):
        pixels, depth = project(view.intrinsics[camera], view.cam_from_world[camera], points)
        metres = np.linalg.norm(np.asarray(pixels) - rows[camera, :, :2], axis=1) * np.asarray(depth)
        off.append(np.where(weights[camera] > 0, metres / float(view.intrinsics[camera, 0, 0]), np.nan)[known])
    return np.asarray(points, float), float(np.nanmedian(np.stack(off))) if known.any() else np.inf, known


class _Description(NamedTuple):
    """Joints and camera directions in the trunk's axes (left, up, ahead), lengths in units of the trunk (metres)."""

    joints: Float[np.ndarray, "13 3"]
    sides: Float[np.ndarray, "camera 2"]
    trunk: float


def _described(
    points: Float[np.ndarray, "13 3"], known: Bool[np.ndarray, "13"], cameras: Cameras, frame: int
) -> _Description | None:
    hips = (points[_L_HIP] + points[_R_HIP]) / 2
    up = (points[_L_SHOULDER] + points[_R_SHOULDER]) / 2 - hips
    trunk = float(np.linalg.norm(up))
    across = points[_L_SHOULDER] - points[_R_SHOULDER] + points[_L_HIP] - points[_R_HIP]
    ahead = np.cross(across, up)
    if min(trunk, float(np.linalg.norm(ahead))) < 1e-6:
        return None
    up, ahead = up / trunk, ahead / np.linalg.norm(ahead)
    axes = np.stack([np.cross(up, ahead), up, ahead])
    joints = np.where(known[:, None], (points - hips) @ axes.T / trunk, np.nan)
    sides = ((np.asarray(cameras.centres(), float)[:, frame] - hips) @ axes.T)[:, [0, 2]]
    return _Description(joints, sides / np.maximum(np.linalg.norm(sides, axis=1, keepdims=True), 1e-9), trunk)


def _flat(capture: Capture, frame: int) -> tuple[_Description | None, int]:
    """Describe the joints as the only camera sees them, about the hips and in units of the trunk; count those seen."""
    found = capture.keypoints(0, frame)
    points = np.zeros((13, 3)) if found is None else np.asarray(found, float)[list(_POINTS)]
    known = points[:, 2] >= _CONFIDENT
    hips = (points[_L_HIP] + points[_R_HIP])[:2] / 2
    trunk = float(np.linalg.norm((points[_L_SHOULDER] + points[_R_SHOULDER])[:2] / 2 - hips))
    if not known[_TORSO].all() or known.sum() < _WELL_SEEN or trunk < 1:
        return None, int(known.sum())
    joints = np.where(known[:, None], np.append((points[:, :2] - hips) / trunk, np.zeros((13, 1)), axis=1), np.nan)
    return _Description(joints, np.zeros((1, 2)), trunk), int(known.sum())


def _distances(described: list[_Description]) -> Float[np.ndarray, "good good"]:
    """Mean distance of the joints both show, in trunk lengths, and `_SIDE` times that of the cameras' directions."""
    joints, sides = (np.stack([getattr(one, name) for one in described]) for name in ("joints", "sides"))
    rows = []
    for one in range(len(described)):
        moved = np.nanmean(np.linalg.norm(joints - joints[one], axis=-1), axis=1)
        turned = np.linalg.norm(sides - sides[one], axis=-1).mean(1)
        rows.append(moved + _SIDE * turned)
    return np.stack(rows)


def _leaps(distance: Float[np.ndarray, "good good"], frames: np.ndarray) -> Bool[np.ndarray, "good"]:
    """Frames far from the one before and the one after, which are near each other."""
    leaps = np.zeros(len(frames), bool)
    for i in range(1, len(frames) - 1):
        if frames[i + 1] - frames[i - 1] == 2:
            away = min(distance[i, i - 1], distance[i, i + 1])
            leaps[i] = away > max(_LEAP, 3 * distance[i - 1, i + 1])
    return leaps


def facility_location(distance: Float[np.ndarray, "frame frame"], frames: np.ndarray, count: int) -> list[int]:
    """Choose rows of `distance` that stand for all.

    The first one is early in `frames`; every further one lowers the sum of distances to the nearest chosen one most.
    There are fewer than `count` when nothing is left to gain.
    """
    early = np.flatnonzero(frames <= frames[0] + _START * (frames[-1] - frames[0]))
    chosen = [int(early[np.argmin(distance[early].sum(1))])]
    nearest = distance[chosen[0]]
    while len(chosen) < min(count, len(frames)):
        left = np.minimum(nearest, distance).sum(1)
        best = int(np.argmin(left))
        if left[best] >= nearest.sum() - 1e-9:
            break
        chosen.append(best)
        nearest = np.minimum(nearest, distance[best])
    return chosen
