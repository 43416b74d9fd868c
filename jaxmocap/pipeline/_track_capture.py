"""A capture folder in, a result folder out: what the command `track` does."""

import time
from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax

from jaxmocap._cache import (
    cached_stage,
    code_hash,
    different,
    digest,
    machine,
    make_room,
    preload_programs,
    programs_recorded,
)
from jaxmocap._files import write_json
from jaxmocap._results import InputError
from jaxmocap._runtime import versions
from jaxmocap._types import Quality, Report
from jaxmocap.capture import Capture, Detections, check_common_size, content_hash, path_hash, triangulated_people
from jaxmocap.character import Character
from jaxmocap.motion import Motion
from jaxmocap.observation import observe
from jaxmocap.refinement import DetectionPlan
from jaxmocap.registration import masks_of, read_pose_file
from jaxmocap.rigging import open_actor
from jaxmocap.track import Checkpoint, Tracker, motion_of, track_frames, with_settings
from jaxmocap.verdict import FrameResult
from jaxmocap.viewers import REPORT_PAGE, overlay_videos, report_page

from ._defaults import mask_record, say_doubts, with_selected_frames
from ._made_to_measure import character_of
from ._register_and_learn import Prepared, register_and_learn, registration_record
from ._run_folder import finished, run_folder


def open_character(
    capture: Capture, actor: str | Path | None = None, say: Callable[[str], None] | None = None
) -> Character:
    """Open the character in the file `actor`, or else the capture's; a bare mesh is rigged, and `say` told so.

    Raises `InputError` when there is neither.
    """
    if actor is not None:
        return open_actor(actor, say)
    if capture.actor is None:
        raise InputError(
            f"capture '{capture.name}' names no actor; add actor = \"FILE.glb\", a skinned glTF or a bare mesh, to "
            "capture.toml."
        )
    return open_actor(capture.actor, say)


def _frame_report(result: FrameResult, status: str) -> dict:
    return {
        "frame": result.frame,
        "status": status,
        "energy": {name: round(value, 5) for name, value in result.energy.items()},
        "signals": None if result.signals is None else result.signals.as_json(),
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
    height: float | None = None,
    tracker: Tracker | None = None,
    settings: Mapping[str, Any] | None = None,
    overlays: bool = True,
    progress: Report | None = None,
    find_masks: bool = True,
    detections: str | Path | None = None,
    detections_frames: Collection[int] | None = None,
    say: Callable[[str], None] | None = None,
    resume: bool = False,
    cache: bool = True,
) -> Motion:
    """Track a capture and write the result folder: `motion.npz`, `report.json`, `registration.json`, one overlay
    video per view, and the report page.

    `frames` is (start, stop). `pose_file` sets single DoFs at selected frames. `actor` is a character's file and
    `tracker` a tracker, instead of the capture's and the preset; where there is no actor, the built-in body is made to
    measure (`character_of`), `height` metres tall if that is known; `settings` change single settings of the tracker by
    name (`with_settings`). Selected frames that the capture does not name are chosen, and masks it does not have are
    found (unless `find_masks` is off); the report says so, and `say` is told at once, also when a mask is doubtful.
    With `detections`, a folder of a detector's files, keypoints count beside the pixels, in `detections_frames` or
    everywhere.

    A run that fails or is killed leaves the frames it has done in `out`, and with `resume` the same call goes on from
    there to the same `motion.npz`, byte for byte; a run that is finished is read. Without frames it leaves nothing.
    Unless `cache` is off, registration and appearance are kept in the user's cache folder and taken from there when
    capture, character, settings, seed and code are the same.
    """
    tell = progress or (lambda stage, done, total: None)
    out = Path(out)
    begin = time.perf_counter()
    make_room()
    run_like = {"path": str(Path(path).resolve()), "quality": quality, "settings": dict(settings or {})}
    preload_programs(run_like)
    filmed = Capture.open(path)
    capture = filmed.one_way_up()
    key = jax.random.key(seed)
    made_body = character_of(
        capture, actor, height, key=jax.random.fold_in(key, 5), say=say, progress=progress, cache=cache
    )
    character = made_body.character
    overrides = read_pose_file(pose_file) if pose_file is not None else None
    if detections is None and detections_frames is not None:
        raise InputError("frames for detections are given, but no detections; name their folder with --detections.")
    found_points = None if detections is None else Detections.open(capture, detections, detections_frames)
    tracker = Tracker.preset(quality) if tracker is None else tracker
    if found_points is not None and tracker.detections is None:
        tracker = replace(tracker, detections=DetectionPlan())
    tracker = with_settings(tracker, settings or {})
    inputs = {
        "capture": content_hash(capture),
        "character": digest(character),
        "pose file": digest(overrides),
        "quality": quality,
        "choice of finding masks": find_masks,
        "seed": seed,
        "version of jaxmocap": code_hash(),
        "set of packages": versions(),
        "machine": machine(),
    }
    run_inputs = inputs | {
        "settings": digest(tracker),
        "span of frames": None if frames is None else list(frames),
        "set of detections": None if detections is None else path_hash(Path(detections)),
        "choice of frames with detections": None if detections_frames is None else sorted(detections_frames),
    }
    if resume and finished(out):
        motion = _finished_motion(out, run_inputs)
        if not (out / REPORT_PAGE).is_file():  # a run was killed before it wrote the page
            report_page(out, capture=filmed, say=say)
        return motion
    with run_folder(out, resume=resume) as (staging, kept_in):
        checkpoint = Checkpoint(kept_in, run_inputs)
        capture, selection = with_selected_frames(capture, overrides, say)
        selected = capture.selected_frames or (0,)
        _say_what_is_beyond(capture, say)
        capture.look_ahead(selected)

        def make() -> Prepared:
            return register_and_learn(capture, character, key, overrides, quality, find_masks, progress)

        made = cached_stage("prepared", inputs | {"selected frames": list(selected)}, make) if cache else make()
        say_doubts(capture, made.masks, say)
        capture = capture.with_masks(masks_of(made.masks))
        cameras = capture.cameras
        observations = observe(capture, cameras, character, made.appearance, made.registrations, found_points)
        prepared = time.perf_counter()
        if not checkpoint.exists:
            tell("track", 0, capture.num_frames if frames is None else frames[1] - frames[0])
        try:
            with programs_recorded(run_like):
                results = track_frames(
                    observations,
                    tracker,
                    key=jax.random.fold_in(key, 3),
                    frames=frames,
                    progress=None if progress is None else lambda step: progress("track", step.done, step.total),
                    checkpoint=checkpoint,
                )
            tracked = time.perf_counter()
            provenance = {
                "capture": str(capture.folder.resolve()),
                "capture_name": capture.name,
                "recorded_sizes": [list(size) for size in capture.recorded_sizes],
                "truth": None if capture.truth is None else str(capture.truth.resolve()),
                "actor": None if made_body.record else str(Path(actor or capture.actor or "").resolve()),
                **({"body": made_body.record} if made_body.record else {}),
                "quality": quality,
                "detections": None if detections is None else str(Path(detections).resolve()),
                "detections_frames": None if detections_frames is None else sorted(detections_frames),
                "settings": {name: str(value) for name, value in (settings or {}).items()},
                "seed": seed,
                "versions": versions(),
                "device": str(jax.devices()[0]),
                "inputs": run_inputs,
                "seconds": {"prepare": prepared - begin, "track": tracked - prepared},
                "selected_frames": selection,
                "registration": registration_record(made.registrations, character, mask_record(capture, made.masks)),
            }
            motion = motion_of(
                observations,
                results,
                provenance,
                tracker.verdict,
                tracker.clip,
                lambda done, total: tell("clip", done, total),
            )
        except BaseException:
            if checkpoint.exists and say is not None:
                say(f"The frames done so far are kept in {out}; the same command with --resume goes on from there.")
            raise
        motion.save(staging)
        write_json(staging / "registration.json", provenance["registration"])
        write_json(
            staging / "report.json",
            {
                **motion.provenance,
                "frames": len(motion),
                "trusted_frames": int(motion.trusted.sum()),
                "lost_frames": int((motion.status == "lost").sum()),
                "doubtful_frames": int((motion.status == "doubtful").sum()),
                "verdicts": [_frame_report(r, str(s)) for r, s in zip(results, motion.status, strict=True)],
            },
        )
        if overlays:
            tell("overlays", 0, 1)
            overlay_videos(filmed, filmed.cameras, motion, staging)
            tell("overlays", 1, 1)
    tell("report page", 0, 1)  # made of what is written; whatever happens to it, the result is safe
    report_page(out, capture=filmed, say=say)
    tell("report page", 1, 1)
    return motion


def _say_what_is_beyond(capture: Capture, say: Callable[[str], None] | None) -> None:
    """Say where the person does not fit into what is tracked of pictures of several shapes."""
    if say is not None and len(set(capture.sizes)) > 1:
        for finding in check_common_size(capture.cameras, triangulated_people(capture, capture.cameras, [])):
            say(f"{finding.message[0].upper()}{finding.message[1:]}.")


def _finished_motion(out: Path, inputs: dict[str, Any]) -> Motion:
    """Load the result in a folder, if it was made of these inputs."""
    motion = Motion.load(out)
    others = different(motion.provenance.get("inputs", {}), inputs)
    if others:
        raise InputError(f"the folder {out} holds the result of another {others}; choose another folder.")
    return motion
