"""A motion at other times, along other axes, and with angles that do not jump."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation, Slerp

from jaxmocap._results import InputError
from jaxmocap.camera import Cameras
from jaxmocap.character import Pose, ball_joints, equivalent_angles

from ._check_motion import STATUSES
from ._motion import Motion

_SLACK = 1e-6
"""Seconds."""

_SPANS = {"contacts": "its frames", "lost": "all between", "doubts": "all between", "outlier_cameras": "all between"}
"""Spans of frames in the provenance; one of doubt also holds for what lies between its frames and the next ones."""


def continuous(motion: Motion) -> Motion:
    """Write the same poses by angles that do not jump.

    A ball joint's other set of angles, or whole turns, are taken where those are nearer to the frame before.
    """
    angles = motion.angles.astype(np.float64)
    for place, twice in ball_joints(motion.character.skeleton):
        for frame in range(1, len(angles)):
            before, now = angles[frame - 1, place], angles[frame, place]
            same = now - 2 * np.pi * np.round((now - before) / (2 * np.pi))
            other = equivalent_angles(same, twice, before, before)
            nearer = np.abs(other - before).sum() < np.abs(same - before).sum()
            angles[frame, place] = other if nearer else same
    return replace(motion, angles=np.unwrap(angles, axis=0))


def at_times(motion: Motion, times: Float[np.ndarray, " time"]) -> Motion:
    """Interpolate the motion at increasing times (seconds) within its own; frames count from 0.

    The pelvis and the centres of the cameras move straight, rotations about one axis, and joint angles, which must
    not jump (`continuous`), evenly. A status is the worse of the two frames' between which it lies, and a part is
    lost between two frames if it is in one of them; contacts last from the time of their first frame to that of their
    last; energies and risks are left out. Raises `InputError` for times outside the motion's.
    """
    times = np.asarray(times, np.float64)
    begin, end = motion.timestamps[[0, -1]]
    if len(times) == 0 or times[0] < begin - _SLACK or times[-1] > end + _SLACK:
        raise InputError(f"The motion lasts from {begin:g} to {end:g} s; other times cannot be interpolated.")
    if len(motion) == 1:
        if len(times) > 1:
            raise InputError(f"The motion has one frame, at {begin:g} s; {len(times)} times cannot be interpolated.")
        return replace(motion, frames=np.arange(1))
    times = np.clip(times, begin, end)
    after = np.clip(np.searchsorted(motion.timestamps, times, side="right"), 1, len(motion) - 1)
    share = (times - motion.timestamps[after - 1]) / (motion.timestamps[after] - motion.timestamps[after - 1])

    def between(values: np.ndarray) -> np.ndarray:
        part = share.reshape(-1, *[1] * (values.ndim - 1))
        return (1 - part) * values[after - 1] + part * values[after]

    pelvis = np.asarray(motion.character.skeleton.pelvis, np.float64)
    root = motion.root.astype(np.float64)
    moved = _slerp(motion.timestamps, root[:, :3, :3], times)
    placed = np.tile(np.eye(4), (len(times), 1, 1))
    placed[:, :3, :3] = moved
    placed[:, :3, 3] = between(root[:, :3, :3] @ pelvis + root[:, :3, 3]) - moved @ pelvis
    rank = np.array([STATUSES.index(status) for status in motion.status])
    worse = np.maximum(np.where(share < 1, rank[after - 1], 0), np.where(share > 0, rank[after], 0))
    return Motion.from_poses(
        motion.character,
        Pose(jnp.asarray(placed, jnp.float32), jnp.asarray(between(motion.angles), jnp.float32)),
        np.arange(len(times)),
        times,
        confidence=between(motion.confidence),
        status=np.array(STATUSES)[worse],
        provenance=_provenance_at(motion, times),
        cameras=None if motion.cameras is None else _cameras_between(motion.cameras, motion.timestamps, times, between),
        up=motion.up,
        covariance=None if motion.covariance is None else between(motion.covariance),
    )


def _provenance_at(motion: Motion, times: Float[np.ndarray, " time"]) -> dict[str, Any]:
    """Count the spans of frames in the provenance in the new frames; what is left of none, and risks, are dropped."""
    counted = {}
    for name, speaks_of in _SPANS.items():
        if motion.provenance.get(name) is not None:
            spans = [_span_at(motion, span, times, speaks_of) for span in motion.provenance[name]]
            counted[name] = [span for span in spans if span is not None]
    kept = {name: value for name, value in motion.provenance.items() if name != "risks"}
    return {**kept, **counted}


def _span_at(
    motion: Motion, span: dict[str, Any], times: Float[np.ndarray, " time"], speaks_of: str
) -> dict[str, Any] | None:
    of = np.flatnonzero((motion.frames >= span["first"]) & (motion.frames <= span["last"]))
    if not len(of):
        return None
    known = motion.timestamps
    if speaks_of == "its frames":
        within = (times > known[of[0]] - _SLACK) & (times < known[of[-1]] + _SLACK)
    else:
        before, after = np.append(-np.inf, known)[of[0]], np.append(known, np.inf)[of[-1] + 1]
        within = (times > before + _SLACK) & (times < after - _SLACK)
    new = np.flatnonzero(within)
    return {**span, "first": int(new[0]), "last": int(new[-1])} if len(new) else None


def _cameras_between(cameras: Cameras, timestamps: np.ndarray, times: np.ndarray, between: Callable) -> Cameras:
    poses = np.asarray(cameras.cam_from_world, np.float64)
    centres = np.asarray(cameras.centres(), np.float64)
    moved = np.tile(np.eye(4), (len(poses), len(times), 1, 1))
    for camera, pose in enumerate(poses):
        moved[camera, :, :3, :3] = _slerp(timestamps, pose[:, :3, :3], times)
        centre = between(centres[camera])
        moved[camera, :, :3, 3] = -np.einsum("tij,tj->ti", moved[camera, :, :3, :3], centre)
    return replace(cameras, cam_from_world=jnp.asarray(moved, jnp.float32))


def _slerp(
    timestamps: Float[np.ndarray, " frame"], matrices: Float[np.ndarray, "frame 3 3"], times: Float[np.ndarray, " time"]
) -> Float[np.ndarray, "time 3 3"]:
    return Slerp(timestamps, Rotation.from_matrix(matrices))(times).as_matrix()


_Y_FROM = {
    "x": np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
    "y": np.eye(3),
    "z": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]),
}


def turned(motion: Motion, up: str) -> Motion:
    """Turn the motion into a world whose vertical axis is `up`; x stays between y and z, z between x and y."""
    if up == motion.up:
        return motion
    turn = np.eye(4)
    turn[:3, :3] = _Y_FROM[up].T @ _Y_FROM[motion.up]
    cameras = motion.cameras
    if cameras is not None:
        cameras = replace(cameras, cam_from_world=jnp.asarray(np.asarray(cameras.cam_from_world, float) @ turn.T))
    covariance = motion.covariance
    if covariance is not None:
        covariance = turn[:3, :3] @ covariance @ turn[:3, :3].T
    return replace(
        motion,
        root=turn @ motion.root,
        joints=motion.joints @ turn[:3, :3].T,
        cameras=cameras,
        up=up,
        covariance=covariance,
    )
