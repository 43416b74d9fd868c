"""The model's scale: from the person's bones or height, or from the distance between two cameras."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.optimize import least_squares

from jaxmocap._results import InputError
from jaxmocap.capture import KEYPOINT_NAMES, Capture, Undistortion
from jaxmocap.character import bone_lengths
from jaxmocap.rigging import open_actor

from ._child import Solved
from ._footage import CONFIDENT

BONES: dict[str, tuple[tuple[str, str], ...]] = {
    "shoulders": (("l_shoulder", "r_shoulder"),),
    "hips": (("l_hip", "r_hip"),),
    "upper_arm": (("l_shoulder", "l_elbow"), ("r_shoulder", "r_elbow")),
    "forearm": (("l_elbow", "l_wrist"), ("r_elbow", "r_wrist")),
    "thigh": (("l_hip", "l_knee"), ("r_hip", "r_knee")),
    "shank": (("l_knee", "l_ankle"), ("r_knee", "r_ankle")),
}
PARTS_OF_HEIGHT = {"upper_arm": 0.16, "forearm": 0.146, "thigh": 0.245, "shank": 0.246}
"""Lengths between joints as parts of an adult's height (Drillis and Contini 1966); the upper arm from the shoulder's
joint as detectors place it, lower than the shoulder's edge that they measured from. People differ by some 4 %."""
_JOINTS = sorted({joint for pairs in BONES.values() for pair in pairs for joint in pair})
_INDEX = np.array([KEYPOINT_NAMES.index(joint) for joint in _JOINTS])
_PIXEL_SIGMA = 3.0  # of a detector, pixels at a width of 960
_BONE_SIGMA = 0.04  # of a bone's length: a detector's joints are not the skeleton's
FEWEST_BONES = 4
_HEIGHT_DEVIATION = 0.04  # limbs of people of one height differ by this


class SubjectView(NamedTuple):
    """What the cameras see of the person at one instant.

    intrinsics: of the cameras
    cam_from_world: their poses
    keypoints: BODY_25 as x, y, confidence; pixels, the lenses' distortion taken out
    """

    intrinsics: Float[np.ndarray, "camera 3 3"]
    cam_from_world: Float[np.ndarray, "camera 4 4"]
    keypoints: Float[np.ndarray, "camera 25 3"]


def confident(keypoints: Float[np.ndarray, "camera 25 3"], lengths: Mapping[str, float]) -> int:
    """Count the bones that two cameras see."""
    seen = np.count_nonzero(keypoints[..., 2] >= CONFIDENT, axis=0) >= 2
    ends = [pair for name in lengths for pair in BONES.get(name, ())]
    return sum(bool(seen[KEYPOINT_NAMES.index(a)] and seen[KEYPOINT_NAMES.index(b)]) for a, b in ends)


class Scale(NamedTuple):
    """The model's scale.

    metres_per_unit: of the model
    deviation: its standard deviation, relative
    source: what it is from
    num_bones: that were measured; 0 where it is not from bones
    num_frames: in which they were
    """

    metres_per_unit: float
    deviation: float
    source: str
    num_bones: int = 0
    num_frames: int = 0


def triangulate_views(view: SubjectView) -> Float[np.ndarray, "25 3"]:
    """Triangulate keypoints by the linear method in float64.

    NaN where fewer than two cameras see one, or where one lies behind a camera.
    """
    seen = view.keypoints[..., 2] >= CONFIDENT
    points = np.full((25, 3), np.nan)
    matrices = view.intrinsics @ view.cam_from_world[:, :3]
    for joint in np.flatnonzero(seen.sum(0) >= 2):
        rows = []
        for camera in np.flatnonzero(seen[:, joint]):
            x, y = view.keypoints[camera, joint, :2]
            matrix = matrices[camera] / view.intrinsics[camera, 0, 0]
            rows += [x * matrix[2] - matrix[0], y * matrix[2] - matrix[1]]
        solution = np.linalg.svd(np.array(rows))[2][-1]
        point = solution[:3] / solution[3]
        depth = view.cam_from_world[seen[:, joint]] @ np.append(point, 1.0)
        if (depth[:, 2] > 0).all():
            points[joint] = point
    return points


def fit_scale(views: Sequence[SubjectView], lengths: Mapping[str, float], source: str, width: int) -> Scale | None:
    """Find the scale at which the person's bones have these lengths (metres); None if fewer than four bones are seen.

    Joints and scale are solved for together (maximum likelihood of keypoints and lengths), since lengths between noisy
    points taken one by one come out too long. `width` of the images in pixels sets the keypoints' noise.
    """
    starts = [triangulate_views(view)[_INDEX] for view in views]
    known = [np.asarray(np.isfinite(points).all(axis=1)) for points in starts]
    bones = [
        (number, _JOINTS.index(a), _JOINTS.index(b), lengths[name])
        for number in range(len(views))
        for name, pairs in BONES.items()
        if name in lengths
        for a, b in pairs
        if known[number][_JOINTS.index(a)] and known[number][_JOINTS.index(b)]
    ]
    if len(bones) < FEWEST_BONES:
        return None
    first = np.array([np.linalg.norm(starts[n][a] - starts[n][b]) / length for n, a, b, length in bones])
    start = -np.log(np.median(first))
    unit = np.exp(-start)  # model units of a metre, so that all unknowns are near one
    offsets = np.cumsum([0, *(3 * k.sum() for k in known)])
    sigma = _PIXEL_SIGMA * width / 960

    def unpack(values: np.ndarray) -> list[np.ndarray]:
        result = []
        for number, these in enumerate(known):
            points = np.full((len(_JOINTS), 3), np.nan)
            points[these] = unit * values[offsets[number] : offsets[number + 1]].reshape(-1, 3)
            result.append(points)
        return result

    def residuals(values: np.ndarray) -> np.ndarray:
        everyone, rows = unpack(values[:-1]), []
        for points, view, these in zip(everyone, views, known, strict=True):
            for camera in range(len(view.intrinsics)):
                found = view.keypoints[camera][_INDEX]
                usable = these & (found[:, 2] >= CONFIDENT)
                inside = points[usable] @ view.cam_from_world[camera, :3, :3].T + view.cam_from_world[camera, :3, 3]
                image = inside @ view.intrinsics[camera].T
                rows.append(((image[:, :2] / image[:, 2:]) - found[usable, :2]).ravel() / sigma)
        stretch = np.exp(start + values[-1])
        rows.append(
            [(stretch * np.linalg.norm(everyone[n][a] - everyone[n][b]) / length - 1) / _BONE_SIGMA
             for n, a, b, length in bones]
        )  # fmt: skip
        return np.concatenate(rows)

    initial = np.concatenate([*((p[k] / unit).ravel() for p, k in zip(starts, known, strict=True)), [0.0]])
    solved = least_squares(residuals, initial, loss="soft_l1", x_scale="jac")
    covariance = np.linalg.pinv(solved.jac.T @ solved.jac)
    return Scale(
        float(np.exp(start + solved.x[-1])), float(np.sqrt(covariance[-1, -1])), source, len(bones), len(views)
    )


def known_bone_lengths(capture: Capture, height: float | None) -> tuple[dict[str, float], str]:
    """Return bone lengths in metres, and where they are from.

    They are the actor's, scaled to the `height` (metres) if given; without an actor those of an adult of that height.
    """
    if capture.actor is None:
        if height is None:
            return {}, "nothing"
        return {name: part * height for name, part in PARTS_OF_HEIGHT.items()}, "height"
    character = open_actor(capture.actor)
    vertical = np.asarray(character.vertices[:, 1])
    stretch = 1.0 if height is None else height / float(np.ptp(vertical))
    lengths = {name: stretch * float(length) for name, length in bone_lengths(character.skeleton).items()}
    return lengths, "actor" if height is None else "actor and height"


def refuse_without_scale(
    capture: Capture, lengths: dict[str, float], keypoints: dict[int, np.ndarray], distance: float | None
) -> None:
    """Raise `InputError`, before the long run, where nothing tells the scale."""
    if distance is not None:
        return
    how = "or give the metres between the first two cameras at their first shared frame with --camera-distance"
    if not lengths:
        raise InputError(
            f"capture '{capture.name}' has no actor to tell its scale: give the person's height with --height, {how}"
        )
    most = max((confident(found, lengths) for found in keypoints.values()), default=0)
    if most < FEWEST_BONES:
        raise InputError(
            f"capture '{capture.name}' has no frame with keypoints of the person's limbs in two cameras "
            f"(at best {most} bones are seen, {FEWEST_BONES} are needed), so its scale cannot be told: add keypoints, "
            f"{how}"
        )


def subject_views(capture: Capture, solved: Solved, keypoints: dict[int, np.ndarray]) -> list[SubjectView]:
    """Take the lenses' distortion out of keypoints, and add the cameras that saw them, in the model's world."""
    lenses = [
        Undistortion(k, d, size) for k, d, size in zip(solved.intrinsics, solved.distortion, capture.sizes, strict=True)
    ]
    views = []
    for frame, found in keypoints.items():
        found = found.copy()
        for camera, lens in enumerate(lenses):
            seen = found[camera, :, 2] > 0
            if seen.any():
                found[camera, seen, :2] = lens.points(found[camera, seen, :2])
        poses = np.stack([solved.pose(camera, frame) for camera in range(capture.num_cameras)])
        views.append(SubjectView(solved.intrinsics, poses, found))
    return views


def find_scale(
    solved: Solved,
    views: list[SubjectView],
    lengths: dict[str, float],
    source: str,
    distance: float | None,
) -> Scale:
    """Find the scale from the metres between the first two cameras where given, else from the person.

    Raises `InputError` where the keypoints make no person, or those cameras stand too close together.
    """
    if distance is not None:
        first, second = (-pose[:3, :3].T @ pose[:3, 3] for pose in (solved.pose(0, 0), solved.pose(1, 0)))
        apart = float(np.linalg.norm(first - second))
        if apart < 0.005 * solved.distance:
            raise InputError(
                f"the first two cameras stand {100 * apart / solved.distance:.1f} % of the distance to the scene apart "
                "at their first shared frame, too close for --camera-distance; give --height instead"
            )
        return Scale(distance / apart, 0.02, "camera distance")
    scale = fit_scale(views, lengths, source, max(max(size) for size in solved.sizes))
    if scale is None:
        raise InputError(
            "the keypoints do not triangulate to a person in front of the cameras, so the scale cannot be told; check "
            "that they belong to these cameras and frames, and that offset in capture.toml is right"
        )
    if source == "height":
        return scale._replace(deviation=float(np.hypot(scale.deviation, _HEIGHT_DEVIATION)))
    return scale
