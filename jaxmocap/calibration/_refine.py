"""Refining the cameras of a capture, and the moments at which its videos began, with the body that was tracked."""

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxmocap._results import InputError
from jaxmocap.camera import Cameras
from jaxmocap.capture import Capture
from jaxmocap.geometry import camera_centres
from jaxmocap.motion import Motion

from ._footage import Report
from ._joint_adjustment import Adjusted, JointPriors, adjust_together, unadjusted
from ._joint_scene import JointScene, moved, predict
from ._sightings import BodySightings, Tracks, body_sightings, read_tracks
from ._world import same_world

_ROUNDS = 3  # of weighing by what is left, which a wrong calibration makes too large at first
_SURE = 2.0  # standard deviations by which an offset must differ to be changed
_LATEST = 0.06  # seconds; more is no refinement
_LEAST_KEYPOINT, _LEAST_BACKGROUND = 1.0, 0.1  # pixels at a width of 960
_MAD_TO_SIGMA = 1.4826


@dataclass(frozen=True)
class RefinedCameras:
    """Refined cameras and offsets, and how they were found.

    Attributes:
        cameras: over the capture's shared frames, metres.
        offsets: what `capture.toml` should say, one per camera, seconds.
        record: what `refinement.json` holds.
        names: of the images of the model on disk; none where only the offsets were refined.
        poses: cam_from_world of these images, metres.
        focal_factors: of the model's focal lengths.
        folder: where the refined model lies, once written; None before.
    """

    cameras: Cameras
    offsets: tuple[float, ...]
    record: dict[str, Any]
    names: tuple[str, ...]
    poses: Float[np.ndarray, "pose 4 4"]
    focal_factors: Float[np.ndarray, " camera"]
    folder: Path | None = None


def refine(
    capture: Capture,
    motion: Motion,
    *,
    detections: str | Path | None = None,
    priors: JointPriors | None = None,
    progress: Report = lambda stage, done, total: None,
) -> RefinedCameras:
    """Refine cameras and offsets by what the background and the tracked body show together (bundle adjustment).

    The background are the tracks of the capture's COLMAP model; a model without points, and static cameras from a file,
    are held, and only the offsets are refined. The body are keypoints that two cameras see at tracked frames, the
    capture's or a folder of `detections`; each is a point that moves as the tracked joint moves. An offset changes only
    where it differs by more than two standard deviations. Raises `InputError` where the motion does not belong to the
    capture, and where there are too few keypoints.
    """
    began = time.perf_counter()
    capture = capture.as_recorded()
    priors = JointPriors() if priors is None else priors
    body = body_sightings(capture, motion, detections)
    tracks = read_tracks(capture, progress)
    has_background = len(tracks.points) > 0
    if not has_background:
        priors = priors._replace(turn=0.0, shift=0.0, focal=0.0)
    scene = make_scene(capture, tracks, body)
    knots, state = unadjusted(scene, priors.apart)
    for number in range(_ROUNDS):
        scene = weighed(scene, predict(scene, knots, state).pixels - scene.pixels, body.alike)
        adjusted = adjust_together(scene, priors, state)
        state = adjusted.state
        progress("adjusting together", number + 1, _ROUNDS)
    late, deviation = adjusted.state.late, adjusted.deviation.late
    worst = int(np.abs(late).argmax())
    if abs(late[worst]) > _LATEST:
        raise InputError(
            f"the body says that camera '{capture.camera_names[worst]}' is {late[worst]:+.3f} s off, more than can be "
            f"refined ({_LATEST} s); run jaxmocap sync {capture.folder}, calibrate and track again"
        )
    poses = moved(scene.cam_from_world, adjusted.knots.at_poses(adjusted.state.twists))
    if has_background:
        poses = same_world(scene.points, state.points).cameras(poses)
    factors = np.exp(adjusted.state.log_focal)
    change = np.where(np.abs(late) > _SURE * deviation, late, 0.0)
    new_offsets = tuple(offset + float(value) for offset, value in zip(capture.offsets, change, strict=True))
    record = {
        "format": 1,
        "cameras": {
            name: {
                "late_seconds": round(float(late[index]), 5),
                "late_deviation_seconds": round(float(deviation[index]), 5),
                "offset_seconds": round(new_offsets[index], 6),
                "focal_factor": round(float(factors[index]), 5),
                **_changes(scene, poses, index),
            }
            for index, name in enumerate(capture.camera_names)
        },
        "residuals_pixels": _residuals(scene, adjusted),
        "body_points": len(body.points),
        "background_points": len(tracks.points),
        "seconds": round(time.perf_counter() - began, 1),
    }
    cameras = _cameras(capture, tracks, scene.cam_from_world, poses, factors)
    return RefinedCameras(cameras, new_offsets, record, tracks.names, poses, factors)


def _residuals(scene: JointScene, adjusted: Adjusted) -> dict[str, list[float | None]]:
    """Take medians before and after, of the background and of the body."""
    states = unadjusted(scene, 1.0), (adjusted.knots, adjusted.state)
    before, after = (np.linalg.norm(predict(scene, *state).pixels - scene.pixels, axis=1) for state in states)
    body = scene.point_of < scene.num_body

    def pair(rows: np.ndarray) -> list[float | None]:
        return [round(float(np.median(values[rows])), 3) if rows.any() else None for values in (before, after)]

    return {"background": pair(~body), "body": pair(body)}


def _changes(scene: JointScene, poses: np.ndarray, camera: int) -> dict[str, float]:
    mine = scene.camera == camera
    shift = np.linalg.norm(camera_centres(poses[mine]) - camera_centres(scene.cam_from_world[mine]), axis=1)
    relative = np.einsum("nij,nkj->nik", poses[mine, :3, :3], scene.cam_from_world[mine, :3, :3])
    turn = np.degrees(np.arccos(np.clip((np.einsum("nii->n", relative) - 1) / 2, -1, 1)))
    return {
        "moved_m": round(float(shift.mean()), 5),
        "moved_most_m": round(float(shift.max()), 5),
        "turned_degrees": round(float(turn.mean()), 4),
    }


def _cameras(
    capture: Capture, tracks: Tracks, before: np.ndarray, after: np.ndarray, factors: Float[np.ndarray, " camera"]
) -> Cameras:
    """Give the capture's cameras the refined poses; a shared frame that the model leaves out is corrected like the
    nearest one."""
    old = capture.cameras
    poses = np.array(old.cam_from_world, np.float64)
    for camera in range(capture.num_cameras):
        mine = np.flatnonzero(tracks.camera == camera)
        for position, frame in enumerate(capture.video_frames[camera]):
            row = mine[np.abs(tracks.frame[mine] - frame).argmin()]
            poses[camera, position] = after[row] @ np.linalg.inv(before[row]) @ poses[camera, position]
    intrinsics = np.array(old.intrinsics, np.float64)
    intrinsics[:, [0, 1], [0, 1]] *= factors[:, None]
    return Cameras(
        old.names, old.sizes, jnp.asarray(intrinsics, jnp.float32), old.distortion, jnp.asarray(poses, jnp.float32)
    )


def make_scene(capture: Capture, tracks: Tracks, body: BodySightings) -> JointScene:
    """Put both into one scene; sightings of the body count where the model has an image of their frame."""
    intrinsics = np.asarray(capture.cameras.intrinsics, float)
    seconds = np.array(
        [
            capture.indices[camera].seconds[min(frame, capture.indices[camera].num_frames - 1)]
            + capture.offsets[camera]
            - capture.offsets[0]
            for camera, frame in zip(tracks.camera, tracks.frame, strict=True)
        ]
    )
    places = zip(tracks.camera.tolist(), tracks.frame.tolist(), strict=True)
    rows = {place: row for row, place in enumerate(places)}
    wanted = [
        rows.get((camera, int(capture.video_frames[camera, position])), -1)
        for camera, position in zip(body.camera.tolist(), body.position.tolist(), strict=True)
    ]
    pose_of = np.array(wanted)
    there = pose_of >= 0
    return JointScene(
        cam_from_world=tracks.cam_from_world,
        camera=tracks.camera,
        seconds=seconds,
        focal=intrinsics[:, [0, 1], [0, 1]],
        centre=intrinsics[:, :2, 2],
        points=np.concatenate([body.points, tracks.points]),
        body=body.body,
        pose_of=np.concatenate([pose_of[there], tracks.pose_of]),
        point_of=np.concatenate([body.point_of[there], len(body.points) + tracks.point_of]),
        pixels=np.concatenate([body.pixels[there], tracks.pixels]),
        sigma=np.ones(int(there.sum()) + len(tracks.pose_of)),
    )


def weighed(scene: JointScene, errors: Float[np.ndarray, "sighting 2"], alike: float) -> JointScene:
    """Set the scene's standard deviations by the median residuals (pixels), apart for the body and the background.

    Errors that are alike count as one, so deviations grow by the root of how many they are: of the body those of
    `alike` neighbouring frames, for a detector errs the same way for a while; of the background all sightings of
    one point by one camera, for they are the texture's.
    """
    camera = scene.camera[scene.pose_of]
    scale = scene.centre.max(axis=1)[camera] / 480  # pixels of a picture 960 wide
    body, sigma = scene.point_of < scene.num_body, np.ones(len(camera))
    for rows, floor in ((body, _LEAST_KEYPOINT), (~body, _LEAST_BACKGROUND)):
        if not rows.any():
            continue
        sightings, points = int(rows.sum()), len(np.unique(scene.point_of[rows]))
        tracks = len(np.unique(np.stack([camera[rows], scene.point_of[rows]]), axis=1).T)
        freedom = max(1 - 1.5 * points / sightings, 0.05)  # three unknowns a point, two numbers a sighting
        found = _MAD_TO_SIGMA * float(np.median(np.abs(errors[rows] / scale[rows, None]))) / np.sqrt(freedom)
        together = alike if floor == _LEAST_KEYPOINT else sightings / tracks
        sigma[rows] = max(found, floor) * np.sqrt(together) * scale[rows]
    return scene._replace(sigma=sigma)
