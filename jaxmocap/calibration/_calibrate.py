"""Calibrating the moving cameras of a capture: structure from motion, then scale, gravity and a report."""

import os
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import UInt8

from jaxmocap._results import InputError
from jaxmocap.camera import Cameras, read_cameras
from jaxmocap.capture import Capture, Undistortion, config_path, read_config, with_cameras_line
from jaxmocap.character import Character, bone_lengths
from jaxmocap.motion import atomic_folder, write_bytes, write_json, write_text

from ._child import run_worker
from ._gravity import find_gravity
from ._job import as_recorded, footage_of, keypoints_of
from ._picture import draw_paths, png_bytes
from ._record import Solved, make_record, pose_table
from ._subject import (
    FEWEST_BONES,
    PARTS_OF_HEIGHT,
    Scale,
    SubjectView,
    confident,
    fit_scale,
    triangulate_views,
)
from ._world import look_at_point, world_from_model

Progress = Callable[[str, int, int], None]

_HEIGHT_DEVIATION = 0.04  # limbs of people of one height differ by this
_MODEL_FILES = ("cameras.bin", "images.bin", "points3D.bin", "rigs.bin", "frames.bin")


@dataclass(frozen=True)
class Calibration:
    """Calibrated cameras over a capture's shared frames, in metres, and how they were found.

    `record` is what `calibration.json` holds, `poses` what `uncertainty.json` holds, `picture` the paths (RGB),
    `files` the COLMAP model in the capture's units and axes by file name.
    """

    cameras: Cameras
    record: dict[str, Any]
    poses: dict[str, Any]
    picture: UInt8[np.ndarray, "height width 3"]
    files: Mapping[str, bytes]

    def save(self, folder: str | Path) -> None:
        """Write the model, `calibration.json`, `uncertainty.json` and `calibration.png` to a new folder, whole or not
        at all."""
        with atomic_folder(folder) as partial:
            for name, data in self.files.items():
                write_bytes(partial / name, data)
            write_json(partial / "calibration.json", self.record)
            write_json(partial / "uncertainty.json", self.poses)
            write_bytes(partial / "calibration.png", png_bytes(self.picture))


def calibrate(
    capture: Capture,
    *,
    height: float | None = None,
    camera_distance: float | None = None,
    up: tuple[float, float, float] | None = None,
    focal: Mapping[str, float] | None = None,
    key_step: int = 5,
    seed: int = 0,
    progress: Progress = lambda stage, done, total: None,
) -> Calibration:
    """Poses of all frames, focal lengths and radial distortion of all cameras of a capture, from its videos.

    Scale: `camera_distance`, metres between the first two cameras at the first shared frame; else the person's bones,
    from keypoints in two views, against the capture's actor, or against a person of `height` metres. Up: the direction
    `up` in the first camera at the first shared frame (x right, y down, z forward), else found. `focal` lengths in
    pixels, by camera, are kept; without them they are found. Whatever cameras the capture has are not looked at.

    Raises `InputError` for footage that cannot be calibrated; nothing is written.
    """
    began = time.perf_counter()
    recorded = as_recorded(capture)
    _refuse_numbers(height, camera_distance, up)
    footage = footage_of(recorded, focal, key_step, _cores(), seed)
    lengths, source = _bone_lengths(recorded, height)
    keypoints = keypoints_of(recorded)
    _refuse_without_scale(recorded, lengths, keypoints, camera_distance)
    with tempfile.TemporaryDirectory(prefix="jaxmocap-") as temporary:
        work = Path(temporary)
        (work / "job.json").write_text(footage.to_json(), encoding="utf-8")
        run_worker("reconstruct", work, progress)
        solved = Solved.read(work / "result.npz", recorded, footage)
        views = _subject_views(recorded, solved, keypoints)
        scale = _scale(solved, views, lengths, source, camera_distance, height)
        people = [triangulate_views(view) for view in views]
        given = None if up is None else solved.pose(0, 0)[:3, :3].T @ np.asarray(up, float)
        gravity = find_gravity(solved.poses, solved.points, solved.distance, people, given)
        joints = np.concatenate([p[np.isfinite(p).all(1)] for p in people]) if people else np.zeros((0, 3))
        ankles = np.concatenate([p[[11, 14]] for p in people]) if people else np.zeros((0, 3))
        world = world_from_model(
            solved.shared_poses().reshape(-1, 4, 4),
            scale.metres_per_unit,
            gravity,
            recorded.up,
            joints if len(joints) else look_at_point(solved.poses)[None],
            ankles[np.isfinite(ankles).all(1)],
        )
        units = 1 / recorded.metres_per_unit
        write_json(
            work / "similarity.json",
            {"scale": units * world.scale, "rotation": world.rotation, "translation": units * world.translation},
        )
        run_worker("transform", work, progress)
        files = {name: (work / "cameras" / name).read_bytes() for name in _MODEL_FILES}
        cameras = read_cameras(
            work / "cameras",
            recorded.camera_names,
            recorded.num_frames,
            recorded.sizes,
            recorded.video_frames,
            recorded.metres_per_unit,
        )
    record = make_record(recorded, solved, scale, gravity, world, joints, time.perf_counter() - began)
    person = world.points(joints)
    picture = draw_paths(recorded, solved, world, person)
    return Calibration(cameras, record, pose_table(recorded, solved, world), picture, files)


def calibrate_in_place(path: str | Path, *, replace: bool = False, **options: Any) -> tuple[Calibration, Path]:
    """Calibrate the capture at `path`, write the result beside it and name it in `capture.toml`; the folder written.

    Raises `InputError` if `capture.toml` names cameras already, unless `replace`; the old ones stay where they are.
    `options` are those of `calibrate`.
    """
    file = config_path(path)
    config, _ = read_config(file)
    if config is not None and config.cameras is not None and not replace:
        raise InputError(
            f"{file} names cameras already ({config.cameras!r}); remove the line, or use --replace, which leaves "
            "the old ones where they are"
        )
    capture = Capture.open(file, with_cameras=False)
    if not os.access(file.parent, os.W_OK):
        raise InputError(f"{file.parent} cannot be written to; copy the capture to a place of your own")
    folder = _free_folder(file.parent)
    text = with_cameras_line(_text(file), folder.name, file)  # before the long run: it may be refused
    calibration = calibrate(capture, **options)
    calibration.save(folder)
    text = with_cameras_line(_text(file), folder.name, file)
    write_text(file, text)
    return calibration, folder


def _text(file: Path) -> str:
    return file.read_bytes().decode("utf-8")  # not read_text, which would change line ends


def _free_folder(parent: Path) -> Path:
    """`cameras`, or the first of `cameras-2`, `cameras-3`, ... that does not exist."""
    number, folder = 1, parent / "cameras"
    while folder.exists():
        number += 1
        folder = parent / f"cameras-{number}"
    return folder


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _refuse_numbers(height: float | None, distance: float | None, up: tuple[float, float, float] | None) -> None:
    if height is not None and not 0.4 < height < 2.6:
        raise InputError(f"--height is {height:g}; the actor's height in metres was expected, such as 1.75")
    if distance is not None and not 0.01 < distance < 200:
        raise InputError(f"--camera-distance is {distance:g}; metres between the first two cameras were expected")
    if up is not None and not (np.isfinite(up).all() and np.linalg.norm(up) > 0):
        raise InputError(f"--up is {up}; three numbers, not all zero, were expected: x right, y down, z forward")


def _bone_lengths(capture: Capture, height: float | None) -> tuple[dict[str, float], str]:
    """Metres, and where they are from: the actor's, made to the `height` if given; without an actor an adult's."""
    if capture.actor is None:
        if height is None:
            return {}, "nothing"
        return {name: part * height for name, part in PARTS_OF_HEIGHT.items()}, "height"
    character = Character.load(capture.actor)
    vertical = np.asarray(character.vertices[:, 1])
    stretch = 1.0 if height is None else height / float(np.ptp(vertical))
    lengths = {name: stretch * float(length) for name, length in bone_lengths(character.skeleton).items()}
    return lengths, "actor" if height is None else "actor and height"


def _refuse_without_scale(
    capture: Capture, lengths: dict[str, float], keypoints: dict[int, np.ndarray], distance: float | None
) -> None:
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


def _subject_views(capture: Capture, solved: Solved, keypoints: dict[int, np.ndarray]) -> list[SubjectView]:
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


def _scale(
    solved: Solved,
    views: list[SubjectView],
    lengths: dict[str, float],
    source: str,
    distance: float | None,
    height: float | None,
) -> Scale:
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
