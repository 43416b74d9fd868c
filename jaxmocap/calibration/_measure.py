"""The model's scale from what is known in metres: the person's bones, a height, or the distance between two cameras."""

import numpy as np

from jaxmocap._results import InputError
from jaxmocap.capture import Capture, Undistortion
from jaxmocap.character import bone_lengths
from jaxmocap.rigging import open_actor

from ._record import Solved
from ._subject import FEWEST_BONES, PARTS_OF_HEIGHT, Scale, SubjectView, confident, fit_scale

_HEIGHT_DEVIATION = 0.04  # limbs of people of one height differ by this


def known_bone_lengths(capture: Capture, height: float | None) -> tuple[dict[str, float], str]:
    """Metres, and where they are from: the actor's, made to the `height` if given; without an actor an adult's."""
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
    """Before the long run: something must tell the scale. Raises `InputError`."""
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
    """Keypoints with the lenses' distortion taken out, and the cameras that saw them, in the model's world."""
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
    """From the metres between the first two cameras where given, else from the person. Raises `InputError` where the
    keypoints make no person, or those cameras stand too close together."""
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
