"""`check`: every precheck in one pass."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import numpy as np

from jaxmocap._results import InputError
from jaxmocap.camera import Cameras, examine_cameras

from ._capture import Capture
from ._check_calibration import check_calibration
from ._check_geometry import check_paths, check_triangulated, triangulated_people
from ._check_people import check_keypoints, check_masks
from ._check_videos import check_sync, check_videos
from ._check_views import check_shared_frames, check_views
from ._choose_frames import choose_frames
from ._config import CaptureConfig, Finding, config_path, missing_files, read_config
from ._flash import check_selected_light
from ._picture_steps import reduced_size
from ._video import VideoIndex, index_video

_Result = TypeVar("_Result")


def _attempt(findings: list[Finding], where: str, action: Callable[[], _Result]) -> _Result | None:
    try:
        return action()
    except InputError as error:
        findings.append(Finding("error", where, str(error)))
        return None


def _build_what_can_be(
    file: Path, config: CaptureConfig, indices: list[VideoIndex | None], findings: list[Finding]
) -> Capture | None:
    """Build the capture of the readable videos; settings that make it impossible are reported and left out."""
    entries = [entry for entry, index in zip(config.camera, indices, strict=True) if index is not None]
    readable = [index for index in indices if index is not None]
    if not readable:
        return None
    config = config.model_copy(update={"camera": entries})
    for removed in ({}, {"frames": None}, {"selected_frames": None}, {"frames": None, "selected_frames": None}):
        attempt: list[Finding] = []
        tried = config.model_copy(update=removed)
        capture = _attempt(attempt, file.name, lambda tried=tried: Capture.from_config(file, tried, readable, []))
        findings += [finding for finding in attempt if finding not in findings]
        if capture is not None:
            return capture
    return None


def _cameras(capture: Capture, findings: list[Finding]) -> Cameras | None:
    """Read the cameras, if that is possible, and report everything that is wrong with each of them."""
    path = capture.cameras_path
    if path is None:
        findings.append(
            Finding(
                "warning", "cameras", f"there are no cameras; run jaxmocap calibrate {capture.folder} before tracking"
            )
        )
        return None
    if not path.exists():
        return None

    def examine(chosen: list[int]) -> tuple[Cameras, list[str]]:
        names, sizes = [capture.camera_names[i] for i in chosen], [capture.sizes[i] for i in chosen]
        frames = capture.video_frames[np.asarray(chosen)]
        return examine_cameras(path, names, capture.num_frames, sizes, frames, capture.metres_per_unit)

    together: list[Finding] = []
    everything = list(range(capture.num_cameras))
    result = _attempt(together, path.name, lambda: examine(everything))
    if result is not None:
        cameras, problems = result
        findings += [Finding("error", path.name, problem) for problem in problems]
        return None if problems else cameras
    before = len(findings)
    for index in everything:
        alone = _attempt(findings, capture.camera_names[index], lambda index=index: examine([index]))
        if alone is not None:
            findings += [Finding("error", capture.camera_names[index], problem) for problem in alone[1]]
    if len({finding.message for finding in findings[before:]}) < 2:  # one cause: say it once, as opening does
        findings[before:] = together
    return None


def _made_smaller(capture: Capture, longest_side: int) -> list[Finding]:
    """Which videos are worked on at a smaller size."""
    findings = []
    for name, size in zip(capture.camera_names, capture.recorded_sizes, strict=True):
        smaller = reduced_size(size, longest_side)
        if smaller != size:
            found, becomes = (f"{width}x{height}" for width, height in (size, smaller))
            told = f"pictures of {found} pixels are made {becomes}; longest_side in capture.toml sets another size"
            findings.append(Finding("note", name, told))
    return findings


def _chosen_frames(capture: Capture, cameras: Cameras) -> Finding:
    chosen = choose_frames(capture, cameras)
    frames = ", ".join(str(capture.video_frames[0, frame]) for frame in chosen.frames)
    return Finding("note", "selected_frames", f"none are given; {frames} would be chosen: {chosen.reason}")


def _about_person(capture: Capture, cameras: Cameras) -> list[Finding]:
    """Check what depends on where the person is: size, place in the pictures, depth, effect of the poses' errors."""
    findings: list[Finding] = []
    people = _attempt(findings, "keypoints", lambda: triangulated_people(capture, cameras, findings)) or {}
    if people:
        findings += check_triangulated(cameras, people)
    distance = None
    if people:
        centres = np.asarray(cameras.centres(), float)
        distance = max(
            float(np.linalg.norm(centres[:, frame] - np.nanmedian(points, axis=0), axis=-1).max())
            for frame, points in people.items()
        )
    return [*findings, *check_views(capture, cameras, people), *check_calibration(capture, cameras, distance)]


def _between(capture: Capture, start: int, stop: int | None) -> Capture:
    """Cut the capture to some of the shared frames."""
    stop = capture.num_frames if stop is None else stop
    if not 0 <= start < stop <= capture.num_frames:
        raise InputError(
            f"frames {start}:{stop} were asked for, and the capture has {capture.num_frames}: A:B needs "
            f"0 <= A < B <= {capture.num_frames}"
        )
    selected = capture.selected_frames
    if selected is not None:
        selected = tuple(frame - start for frame in selected if start <= frame < stop) or None
    own = capture.video_frames[:, start:stop]
    return replace(capture, video_frames=own, num_frames=stop - start, selected_frames=selected)


def check(path: str | Path, frames: tuple[int, int | None] | None = None) -> list[Finding]:
    """List everything that is wrong or worth knowing about a capture, errors first; nothing stops at the first problem.

    Videos are decoded (long ones at the beginning, middle and end). Errors carry the sentences `Capture.open` raises.
    With `frames`, what is said about cameras and person is about the shared frames from the first to before the second,
    None for the last; the files are examined whole.
    """
    findings: list[Finding] = []
    file = _attempt(findings, str(path), lambda: config_path(path))
    if file is None:
        return findings
    config, about_config = read_config(file)
    findings += about_config
    if config is None:
        return findings
    indices = [
        _attempt(findings, entry.name, lambda entry=entry: index_video(file.parent / entry.video))
        for entry in config.camera
    ]
    findings += [Finding("error", key, sentence) for key, sentence in missing_files(file, config)]
    if config.truth is not None and not (file.parent / config.truth).is_file():
        findings.append(Finding("warning", "truth", f"{file}: truth = {config.truth!r} does not exist"))
    if len(config.camera) == 1:
        findings.append(Finding("warning", "videos", "there is one camera; depth needs two or three"))
    findings += check_videos(config, indices)
    findings += check_sync(file, config)
    capture = _build_what_can_be(file, config, indices, findings)
    if capture is not None:
        findings += check_shared_frames(capture)
    if capture is not None and frames is not None:
        capture = _attempt(findings, "frames", lambda whole=capture: _between(whole, *frames))
    if capture is not None:
        findings += [finding for finding in capture.findings if finding not in findings]
        findings += _made_smaller(capture, config.longest_side)
        cameras = _cameras(capture, findings)
        findings += check_keypoints(capture)
        findings += check_masks(capture)
        if cameras is not None:
            findings += check_paths(capture, cameras)
            findings += _about_person(capture, cameras)
            findings += _attempt(findings, "selected_frames", lambda: list(check_selected_light(capture))) or []
            if config.selected_frames is None and capture.keypoints_folder is not None:
                note = _attempt(findings, "keypoints", lambda: _chosen_frames(capture, cameras))
                findings += [] if note is None else [note]
    order = {"error": 0, "warning": 1, "note": 2}
    return sorted(findings, key=lambda finding: order[finding.severity])
