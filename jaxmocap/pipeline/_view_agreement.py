"""Points of one view held against the other views: a point has to lie near the epipolar line of what they see."""

from dataclasses import replace
from itertools import combinations

import numpy as np
from jaxtyping import Bool, Float64

from jaxmocap._results import InputError
from jaxmocap.camera import Cameras
from jaxmocap.capture import Capture, Undistortion
from jaxmocap.detection import LAYOUTS, FollowedPerson, best_person

_SHARE = 0.05  # of the region's side; what a point may lie beside its epipolar line in any case
_USUAL = 5.0  # times what is usual between two views
_FARTHEST = 0.1  # of the region's side; what is farther agrees in no case
_OTHER = 0.5  # share of a picture's limb joints that agree with no view, above which it is another person
_LIMBS = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
_ASKED = 60  # frames
_CONFIDENT = 0.3
_FEWEST = 30  # points
_CONTRADICTING = 12.0
"""Pixels of a picture whose longer side is 960. Real and rendered captures with right cameras have 1.6 to 5.5 (of 512 x
512 pixels), two different people and cameras that are 7 to 10 degrees wrong 23 to 57."""
_MOST = 0.25  # the same share in most pictures, from which cameras or time are to blame, not the detector


def agreeing(capture: Capture, people: dict[str, FollowedPerson]) -> tuple[dict[str, FollowedPerson], float]:
    """Give confidence 0 to every point that other views see and none agrees with; with two views that is in both.

    A view agrees that sees the point within 5 % of the region's side of its epipolar line, or within five times the
    median distance of the two views, if that is no more than 10 %. A person of whom more than half of the joints of
    the limbs agree with no view is another one in that picture, and no point is believed. Returns the people and the
    share of these joints that had none to agree with them, in the median over the pictures; from a quarter on nothing
    is changed, for then cameras or offsets are wrong. `capture` must be as recorded, with cameras.
    """
    cameras = capture.cameras
    names = [name for name in capture.camera_names if name in people]
    views = np.array([capture.camera_names.index(name) for name in names])
    rows = np.full((len(names), capture.num_frames), -1)
    for view, (name, index) in enumerate(zip(names, views, strict=True)):
        where = {frame: row for row, frame in enumerate(people[name].frames.tolist())}
        rows[view] = [where.get(int(frame), -1) for frame in capture.video_frames[index]]
    layout = next(one for one in LAYOUTS.values() if len(one.points) == people[names[0]].points.shape[1])
    limbs = [row for row, point in enumerate(layout.points) if point.endswith(_LIMBS)]
    points, sides = np.zeros((*rows.shape, len(layout.points), 3)), np.zeros(rows.shape)
    for view, name in enumerate(names):
        known = rows[view] >= 0
        points[view, known] = people[name].points[rows[view, known]]
        sides[view, known] = people[name].sides[rows[view, known]]
    heard, agreed = _agreement(_undistorted(points, cameras, views), sides, cameras, views)
    alone = heard & ~agreed
    shares = alone[..., limbs].sum(-1) / np.maximum(heard[..., limbs].sum(-1), 1)
    share = float(np.median(shares[heard.any(-1)])) if heard.any() else 0.0
    alone |= (shares > _OTHER)[..., None]
    if share >= _MOST or not alone.any():
        return people, share
    result = dict(people)
    for view, name in enumerate(names):
        changed = people[name].points.copy()
        known = rows[view] >= 0
        changed[rows[view, known], :, 2] *= ~alone[view, known]
        result[name] = replace(people[name], points=changed)
    return result, share


def refuse_views_of_different_people(capture: Capture, within: tuple[int, int | None] = (0, None)) -> None:
    """Raise `InputError` where the person's keypoints contradict the cameras; `capture` has cameras.

    They do where they lie more than `_CONTRADICTING` from the other view's epipolar lines in the median over the frames
    `within` (first, end).
    """
    far = [pair for pair in beside_lines(capture, within) if pair[2] > _CONTRADICTING]
    if far:
        first, second, distance = max(far, key=lambda pair: pair[2])
        raise InputError(
            f"the person's keypoints in '{first}' and '{second}' lie {distance:.0f} pixels (of 960) beside "
            f"where the cameras have them, expected below {_CONTRADICTING:.0f}: the views follow different people "
            "(--person), show other moments (--offset), or the cameras are wrong (--focal, or longer videos)"
        )


def beside_lines(capture: Capture, within: tuple[int, int | None] = (0, None)) -> list[tuple[str, str, float]]:
    """Measure for every two cameras how far the person's keypoints lie from the other view's epipolar lines.

    Of at most `_ASKED` frames `within` (first, end), evenly spread, the median, in pixels of a picture whose longer
    side is 960; without cameras that share too few points. `capture` has cameras.
    """
    found = []
    span = range(capture.num_frames)[slice(*within)]
    frames = [set(capture.keypoint_frames(camera)).intersection(span) for camera in range(capture.num_cameras)]
    for first, second in combinations(range(capture.num_cameras), 2):
        shared = np.array(sorted(frames[first] & frames[second]), int)
        shared = shared[np.unique(np.linspace(0, len(shared) - 1, min(_ASKED, len(shared))).round().astype(int))]
        here, there = (_points_of(capture, camera, shared) for camera in (first, second))
        both = (here[..., 2] >= _CONFIDENT) & (there[..., 2] >= _CONFIDENT)
        if both.sum() >= _FEWEST:
            matrices = _fundamental(capture.cameras, first, second)[shared]
            far = np.maximum(
                _beside_line(here, there, matrices) / max(capture.sizes[second]),
                _beside_line(there, here, matrices.transpose(0, 2, 1)) / max(capture.sizes[first]),
            )
            names = capture.camera_names[first], capture.camera_names[second]
            found.append((*names, 960 * float(np.median(far[both]))))
    return found


def _points_of(capture: Capture, camera: int, frames: np.ndarray) -> Float64[np.ndarray, "frame 25 3"]:
    """Read the person's points in some frames, confidence 0 where there is nobody."""
    people = [best_person(capture.people(camera, int(frame))) for frame in frames]
    return np.array([np.zeros((25, 3)) if person is None else person for person in people]).reshape(-1, 25, 3)


def _undistorted(points: np.ndarray, cameras: Cameras, views: np.ndarray) -> np.ndarray:
    intrinsics, distortion = np.asarray(cameras.intrinsics, float), np.asarray(cameras.distortion, float)
    result = points.copy()
    for row, view in enumerate(views):
        if distortion[view].any():
            found = result[row, ..., 2] > 0
            lens = Undistortion(intrinsics[view], distortion[view], cameras.sizes[view])
            result[row, found, :2] = lens.points(result[row, found, :2])
    return result


def _agreement(
    points: Float64[np.ndarray, "view frame point 3"],
    sides: Float64[np.ndarray, "view frame"],
    cameras: Cameras,
    views: np.ndarray,
) -> tuple[Bool[np.ndarray, "view frame point"], Bool[np.ndarray, "view frame point"]]:
    """Whether any other view sees a point too, and whether one of those agrees."""
    heard, agreed = np.zeros(points.shape[:3], bool), np.zeros(points.shape[:3], bool)
    for first, second in combinations(range(len(points)), 2):
        both = (points[first, ..., 2] > 0) & (points[second, ..., 2] > 0)
        if not both.any():
            continue
        matrices = _fundamental(cameras, views[first], views[second])
        there = _beside_line(points[first], points[second], matrices) / np.maximum(sides[second], 1)[:, None]
        back = matrices.transpose(0, 2, 1)
        here = _beside_line(points[second], points[first], back) / np.maximum(sides[first], 1)[:, None]
        distance = np.maximum(here, there)
        limit = min(max(_SHARE, _USUAL * float(np.median(distance[both]))), _FARTHEST)
        near = both & (distance <= limit)
        for view in (first, second):
            heard[view] |= both
            agreed[view] |= near
    return heard, agreed


def _fundamental(cameras: Cameras, first: int, second: int) -> Float64[np.ndarray, "frame 3 3"]:
    """F of every frame, such that x2^T F x1 = 0 (Hartley and Zisserman 2003, Eq. 9.2)."""
    intrinsics, poses = np.asarray(cameras.intrinsics, float), np.asarray(cameras.cam_from_world, float)
    relative = poses[second] @ np.linalg.inv(poses[first])
    x, y, z = relative[:, :3, 3].T
    nought = np.zeros_like(x)
    cross = np.stack([nought, -z, y, z, nought, -x, -y, x, nought], axis=-1).reshape(-1, 3, 3)
    inverse = np.linalg.inv(intrinsics)
    return inverse[second].T @ cross @ relative[:, :3, :3] @ inverse[first]


def _beside_line(
    points: Float64[np.ndarray, "frame point 3"],
    others: Float64[np.ndarray, "frame point 3"],
    matrices: Float64[np.ndarray, "frame 3 3"],
) -> Float64[np.ndarray, "frame point"]:
    """How far `others` lie from the epipolar lines of `points`, pixels."""
    lines = _homogeneous(points) @ matrices.transpose(0, 2, 1)
    off = np.abs((lines * _homogeneous(others)).sum(-1))
    return off / np.maximum(np.linalg.norm(lines[..., :2], axis=-1), 1e-12)


def _homogeneous(points: np.ndarray) -> np.ndarray:
    return np.concatenate([points[..., :2], np.ones_like(points[..., :1])], axis=-1)
