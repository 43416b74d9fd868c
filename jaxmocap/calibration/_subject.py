"""What is known of the person, and what the cameras see of them: bone lengths, keypoints, triangulated points."""

from collections.abc import Container, Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

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


class SubjectView(NamedTuple):
    """What the cameras see of the person at one instant.

    Attributes:
        intrinsics: of the cameras, pixels.
        cam_from_world: their poses, in the model's units.
        keypoints: BODY_25 as x, y, confidence; pixels, the lenses' distortion taken out.
    """

    intrinsics: Float[np.ndarray, "camera 3 3"]
    cam_from_world: Float[np.ndarray, "camera 4 4"]
    keypoints: Float[np.ndarray, "camera 25 3"]


def confident(keypoints: Float[np.ndarray, "camera 25 3"], lengths: Mapping[str, float]) -> int:
    """Count the bones that two cameras see."""
    seen = np.count_nonzero(keypoints[..., 2] >= CONFIDENT, axis=0) >= 2
    ends = [pair for name in lengths for pair in BONES.get(name, ())]
    return sum(bool(seen[KEYPOINT_NAMES.index(a)] and seen[KEYPOINT_NAMES.index(b)]) for a, b in ends)


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


def keypoints_of(capture: Capture, wanted: Container[int], most: int = 30) -> dict[int, np.ndarray]:
    """Read BODY_25 keypoints, (camera, 25, 3) by shared frame, in pixels of the recorded videos.

    Frames are those at which two cameras have keypoints, at most `most` of them, and whose own number in the first
    video is among the `wanted`. `capture` is as recorded.
    """
    frames = [set(capture.keypoint_frames(camera)) for camera in range(capture.num_cameras)]
    shared = sorted(f for f in set().union(*frames) if sum(f in own for own in frames) >= 2)
    shared = [frame for frame in shared if int(capture.video_frames[0, frame]) in wanted]
    found = {}
    for frame in shared[:: max(1, -(-len(shared) // most))]:
        people = [capture.keypoints(camera, frame) for camera in range(capture.num_cameras)]
        found[frame] = np.stack([np.zeros((25, 3)) if person is None else person for person in people])
    return found


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
