"""Keypoints and cameras that are refused: what to film instead, in one sentence."""

from collections.abc import Sequence
from itertools import combinations

import cv2
import numpy as np
from jaxtyping import Float, Int

from jaxmocap._results import InputError

from ._person_scene import Keypoints

FEWEST_FRAMES = 10
FEWEST_JOINTS = 6  # in a frame
_LEAST_MOTION = 0.15  # of the person's size
_AGREES = 0.015  # of the person's size: a keypoint that is no farther off
_AGREEING = 0.6  # of the keypoints, at least
_IN_PLANE = 0.02  # of the person's size: a point that a homography explains
_MOST_IN_PLANE = 0.5  # of the points; of people who walk about it is a third at most
_LEAST_ANGLE = 8.0  # degrees between two cameras' views
_LARGEST_DEVIATION = 5.0  # degrees


def listed(names: Sequence[str]) -> str:
    """Join names of cameras, in quotes, by and."""
    return " and ".join(f"'{name}'" for name in names)


def refuse_keypoints(
    seen: Keypoints, frames: Int[np.ndarray, " frame"], size: Float[np.ndarray, " camera"], names: Sequence[str]
) -> None:
    """Raise `InputError` for too few keypoints, and for a person who does not move."""
    if len(frames) < FEWEST_FRAMES:
        raise InputError(
            f"cameras that stand still are placed by the person: keypoints of {FEWEST_JOINTS} joints in two cameras at "
            f"{FEWEST_FRAMES} frames are needed, found at {len(frames)}; run jaxmocap detect, or give keypoint files "
            "of more frames"
        )
    motion = []
    for camera in range(len(names)):
        often = seen.seen[camera][frames].mean(axis=0) > 0.3
        track = np.where(seen.seen[camera][..., None], seen.pixels[camera], np.nan)[frames][:, often]
        low, high = np.nanpercentile(track, [5, 95], axis=0)
        reach = np.linalg.norm(high - low, axis=-1)
        motion.append(float(np.median(reach)) / size[camera] if len(reach) else 0.0)
    if max(motion) < _LEAST_MOTION:
        raise InputError(
            f"the person hardly moves ({100 * max(motion):.0f} % of their size in the pictures), and cameras that "
            "stand still are placed by that motion: film the person walking about, towards the cameras and across, for "
            "some seconds"
        )
    _refuse_plane(seen, size)


def _refuse_plane(seen: Keypoints, size: np.ndarray) -> None:
    """Raise `InputError` where one homography explains most points of every two cameras: they lie in one plane."""
    shares = []
    for one, other in combinations(range(len(size)), 2):
        both = seen.seen[one] & seen.seen[other]
        if both.sum() >= FEWEST_FRAMES * FEWEST_JOINTS:
            places = seen.pixels[one][both], seen.pixels[other][both]
            _, explained = cv2.findHomography(*places, cv2.RANSAC, _IN_PLANE * size[other])
            shares.append(0.0 if explained is None else float(explained.mean()))
    if shares and min(shares) > _MOST_IN_PLANE:
        raise InputError(
            "the person stays in one plane, which does not tell where the cameras stand: film the person walking "
            "about, towards the cameras and across, and turning"
        )


def refuse_rig(
    poses: Float[np.ndarray, "camera 4 4"],
    points: Float[np.ndarray, "frame joint 3"],
    residual: Float[np.ndarray, "camera frame joint"],
    size: Float[np.ndarray, " camera"],
    names: Sequence[str],
) -> None:
    """Raise `InputError` for cameras that the keypoints do not tell."""
    for camera, name in enumerate(names):
        off = residual[camera][np.isfinite(residual[camera])] / size[camera]
        if not len(off) or np.mean(off < _AGREES) < _AGREEING:
            raise InputError(
                f"the keypoints of '{name}' and the other cameras do not fit each other: only "
                f"{np.mean(off < _AGREES):.0%} of them agree to {_AGREES * size[camera]:.0f} pixels; are they of the "
                "same person and the same moments (offset in capture.toml)? jaxmocap sync finds the offsets"
            )
    points = points[np.isfinite(points).all(-1)]
    middle = np.median(points, axis=0)
    rays = -np.einsum("cji,cj->ci", poses[:, :3, :3], poses[:, :3, 3]) - middle
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    cosines = (rays @ rays.T)[np.triu_indices(len(rays), 1)]
    angles = np.degrees(np.arccos(np.clip(cosines, -1, 1)))
    if (np.minimum(angles, 180 - angles) < _LEAST_ANGLE).all():
        raise InputError(
            f"{listed(names)} see the person from nearly the same direction or from opposite ones "
            f"({angles[0]:.0f} degrees apart): place them 30 to 120 degrees apart"
        )


def refuse_uncertain(angle_deviation: Float[np.ndarray, " camera"]) -> None:
    """Raise `InputError` for orientations that the motion does not tell."""
    deviation = float(np.degrees(angle_deviation.max()))
    if deviation > _LARGEST_DEVIATION:
        raise InputError(
            f"the person's motion tells the cameras' orientations only to {deviation:.0f} degrees: film the person "
            "walking about the whole of the place that both cameras see, towards them and across, for ten seconds or "
            "more, or give the focal lengths with --focal"
        )
