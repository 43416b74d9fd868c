"""A capture folder in, a result folder out: what the command `track` does."""

import platform
import time
from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jaxmocap._complete import MaskRecord, mask_record, with_person_masks, with_selected_frames
from jaxmocap._results import InputError
from jaxmocap.capture import Capture, Detections
from jaxmocap.character import Character
from jaxmocap.motion import Motion, claim_output, write_json
from jaxmocap.observation import fit_capture_appearance
from jaxmocap.track import (
    DetectionPlan,
    FrameResult,
    Progress,
    Quality,
    Registration,
    Tracker,
    appearance_preset,
    key_poses_of,
    motion_of,
    observe,
    read_pose_file,
    register,
    track_frames,
    with_settings,
)
from jaxmocap.viewers import overlay_videos

Report = Callable[[str, int, int], None]
"""Told what is being done, how much of it is done, and how much there is."""


def versions() -> dict[str, str]:
    found = {"python": platform.python_version()}
    for package in ("jaxmocap", "jax", "jaxlib", "equinox", "optimistix", "numpy", "opencv-python-headless", "av"):
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "not installed"
    return found


def open_character(capture: Capture, actor: str | Path | None = None) -> Character:
    """The character in the file `actor`, or else the capture's. Raises `InputError` when there is neither."""
    if actor is not None:
        return Character.load(actor)
    if capture.actor is None:
        raise InputError(
            f"capture '{capture.name}' names no actor; add actor = \"FILE.glb\", a skinned glTF, to capture.toml."
        )
    return Character.load(capture.actor)


def registration_record(registrations: dict[int, Registration], character: Character, masks: MaskRecord) -> dict:
    """What `registration.json` holds: per selected frame the fit, the masks and the pose, metres and degrees."""
    from jaxmocap.character import pose_vector

    record = {}
    for frame, found in registrations.items():
        vector = np.array(pose_vector(character.skeleton, found.pose), np.float64)
        vector[3:] = np.rad2deg(vector[3:])
        record[str(frame)] = {
            "iou": [None if np.isnan(v) else round(float(v), 4) for v in found.iou],
            "keypoint_rms_m": None if np.isnan(found.keypoint_rms) else round(found.keypoint_rms, 4),
            "searched": found.searched,
            "masks": masks[str(frame)],
            "pose": {name: round(float(v), 5) for name, v in zip(character.skeleton.dof_names, vector, strict=True)},
        }
    return record


def _frame_report(result: FrameResult) -> dict:
    return {
        "frame": result.frame,
        "status": result.status,
        "energy": {name: round(value, 5) for name, value in result.energy.items()},
        "seconds": {name: round(value, 3) for name, value in result.seconds.items()},
    }


def track_capture(
    path: str | Path,
    out: str | Path,
    *,
    quality: Quality = "normal",
    seed: int = 0,
    frames: tuple[int, int] | None = None,
    pose_file: str | Path | None = None,
    actor: str | Path | None = None,
    tracker: Tracker | None = None,
    settings: Mapping[str, Any] | None = None,
    overlays: bool = True,
    progress: Report | None = None,
    find_masks: bool = True,
    detections: str | Path | None = None,
    detections_frames: Collection[int] | None = None,
    say: Callable[[str], None] | None = None,
) -> Motion:
    """Track a capture and write the result folder: `motion.npz`, `report.json`, `registration.json` and one overlay
    video per view. Nothing is left behind when it fails.

    `frames` is (start, stop). `pose_file` sets single DoFs at selected frames. `actor` is a character's file and
    `tracker` a tracker, instead of the capture's and the preset; `settings` change single settings of the tracker by
    name (`with_settings`). Selected frames that the capture does not name are chosen, and masks it does not have are
    found (unless `find_masks` is off); the report says so, and `say` is told at once, also when a mask is doubtful.
    With `detections`, a folder of BODY_25 files, keypoints count beside the pixels, in `detections_frames` or
    everywhere.
    """
    tell = progress or (lambda stage, done, total: None)
    begin = time.perf_counter()
    with claim_output(out) as staging:
        capture = Capture.open(path)
        character = open_character(capture, actor)
        cameras = capture.cameras
        overrides = read_pose_file(pose_file) if pose_file is not None else None
        if detections is None and detections_frames is not None:
            raise InputError("frames for detections are given, but no detections; name their folder with --detections.")
        found_points = None if detections is None else Detections.open(capture, detections, detections_frames)
        tracker = Tracker.preset(quality) if tracker is None else tracker
        if found_points is not None and tracker.detections is None:
            tracker = replace(tracker, detections=DetectionPlan())
        tracker = with_settings(tracker, settings or {})
        capture, selection = with_selected_frames(capture, overrides, say)
        key = jax.random.key(seed)
        selected = capture.selected_frames or (0,)
        unknown = sorted(set(overrides or {}) - set(selected))
        if unknown:
            raise InputError(
                f"the pose file {pose_file} sets frame {unknown[0]}, which is not registered; the selected frames of "
                f"capture '{capture.name}' are {', '.join(map(str, selected))}."
            )
        capture, found = with_person_masks(
            capture,
            character,
            key=jax.random.fold_in(key, 4),
            overrides=overrides,
            find=find_masks,
            say=say,
            progress=progress,
        )
        tell("register", 0, len(selected))
        registrations: dict[int, Registration] = {}
        for number, frame in enumerate(selected):
            registrations |= register(
                capture, cameras, character, (frame,), key=jax.random.fold_in(key, 1), overrides=overrides
            )
            tell("register", number + 1, len(selected))
        tell("appearance", 0, 1)
        appearance = fit_capture_appearance(
            capture,
            cameras,
            character,
            key_poses_of(registrations),
            key=jax.random.fold_in(key, 2),
            settings=appearance_preset(quality),
        )
        observations = observe(capture, cameras, character, appearance, registrations, found_points)
        tell("appearance", 1, 1)
        prepared = time.perf_counter()

        def told(step: Progress) -> None:
            tell("track", step.done, step.total)

        results = track_frames(observations, tracker, key=jax.random.fold_in(key, 3), frames=frames, progress=told)
        tracked = time.perf_counter()
        provenance = {
            "capture": str(capture.folder.resolve()),
            "capture_name": capture.name,
            "truth": None if capture.truth is None else str(capture.truth.resolve()),
            "actor": str(Path(actor or capture.actor or "").resolve()),
            "quality": quality,
            "detections": None if detections is None else str(Path(detections).resolve()),
            "detections_frames": None if detections_frames is None else sorted(detections_frames),
            "settings": {name: str(value) for name, value in (settings or {}).items()},
            "seed": seed,
            "versions": versions(),
            "device": str(jax.devices()[0]),
            "seconds": {"prepare": prepared - begin, "track": tracked - prepared},
            "selected_frames": selection,
            "registration": registration_record(registrations, character, mask_record(capture, found)),
        }
        motion = motion_of(observations, results, provenance, tracker.verdict)
        motion.save(staging)
        write_json(staging / "registration.json", provenance["registration"])
        write_json(
            staging / "report.json",
            {
                **motion.provenance,
                "frames": len(motion),
                "lost_frames": int((motion.status == "lost").sum()),
                "doubtful_frames": int((motion.status == "doubtful").sum()),
                "verdicts": [_frame_report(result) for result in results],
            },
        )
        if overlays:
            tell("overlays", 0, 1)
            overlay_videos(capture, motion.cameras or cameras, motion, staging)
            tell("overlays", 1, 1)
    return motion
