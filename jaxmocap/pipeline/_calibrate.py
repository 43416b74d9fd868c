"""Calibrating a capture: one in memory, one on disk that is completed in place, or a new one made of videos."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from jaxmocap import calibration
from jaxmocap._results import InputError
from jaxmocap.calibration import Calibration, calibrate_in_place
from jaxmocap.capture import SYNC_REPORT, Capture, config_path, read_config

from ._synchronise import new_capture


def calibrate(
    capture: Capture | str | Path | Sequence[str | Path],
    out: str | Path | None = None,
    *,
    replace: bool = False,
    height: float | None = None,
    camera_distance: float | None = None,
    up: tuple[float, float, float] | None = None,
    focal: Mapping[str, float] | None = None,
    intrinsics: str | Path | None = None,
    static: bool | None = None,
    frames: tuple[int, int | None] | None = None,
    keep_offsets: bool = False,
    key_step: int = 5,
    seed: int = 0,
    say: Callable[[str], None] = lambda sentence: None,
    progress: Callable[[str, int, int], None] = lambda stage, done, total: None,
) -> Calibration:
    """Find the poses at every frame, the focal lengths and the radial distortion of cameras from their videos.

    Cameras that move are found by the background that they see; cameras that all stand still (told by their background,
    or by `static`, which is true or false) by the person's keypoints at all frames.

    `capture` is an open `Capture`, and nothing is written; or a capture folder or its `capture.toml`, in which a new
    folder is written and named as `cameras`; or, with `out`, a list of videos, which are synchronised and become the
    capture `out`, whole or not at all. `Calibration.folder` says where the cameras lie. `replace` calibrates though
    `capture.toml` names cameras; those stay on disk.

    Scale: `camera_distance`, metres between the first two cameras at their first shared frame; else the person's bones,
    from keypoints in two views, against the capture's actor, or against a person of `height` metres. Up: the direction
    `up` in the first camera at the first shared frame (x right, y down, z forward), else found. `focal` lengths in
    pixels, by camera, are kept; without them they are found. `intrinsics` is a calibration file whose lenses are kept,
    of cameras that stand still; its poses do not count. `frames` (first, end) are the shared frames that are wanted, by
    default all: a camera that is lost for a second on end is refused there, and elsewhere filled in. Keypoints at many
    frames tell to a fraction of a frame when the videos began; `offset` is set where that is known, unless
    `keep_offsets`. `say` takes sentences about what is assumed and found.

    Raises `InputError`, with nothing changed on disk, for footage that cannot be calibrated.
    """
    options = {
        "height": height,
        "camera_distance": camera_distance,
        "up": up,
        "focal": focal,
        "intrinsics": intrinsics,
        "static": static,
        "frames": frames or (0, None),
        "keep_offsets": keep_offsets,
        "key_step": key_step,
        "seed": seed,
        "progress": progress,
    }
    if isinstance(capture, Capture):
        if out is not None:
            raise InputError("an open capture is calibrated without out; save the calibration, or give the folder")
        return calibration.calibrate(capture, **options)
    paths = [capture] if isinstance(capture, str | Path) else list(capture)
    if out is not None:
        return _calibrate_videos(paths, Path(out), say, options)
    if len(paths) != 1:
        raise InputError(
            f"{len(paths)} paths were given; give one capture folder, or two or more videos and a new folder with --out"
        )
    return calibrate_folder(paths[0], say, replace=replace, **options)


def calibrate_folder(folder: str | Path, say: Callable[[str], None], **options: Any) -> Calibration:
    """Calibrate the capture in a folder; `options` are those of `calibrate_in_place`."""
    _say_if_unsynchronised(folder, say)
    found = calibrate_in_place(folder, **options)
    _say_what_time(found, say)
    return found


def _calibrate_videos(
    videos: Sequence[str | Path], out: Path, say: Callable[[str], None], options: dict
) -> Calibration:
    if options["camera_distance"] is None:
        height = options["height"]
        with_height = "" if height is None else "--height counts with keypoints, which a list of videos has not: "
        raise InputError(
            f"{with_height}videos alone do not tell their scale; give the metres between the first two cameras at "
            "their first shared frame with --camera-distance, or make the capture first: jaxmocap sync "
            f"{' '.join(map(str, videos))} --out {out}, then jaxmocap detect {out}, then jaxmocap calibrate {out} "
            f"--height {1.75 if height is None else height:g}"
        )
    with new_capture(videos, out, progress=options["progress"]) as (plan, partial):
        for note in plan.found.notes:
            say(f"{note}.")
        found = calibrate_in_place(partial, **options)
    assert found.folder is not None
    return dataclasses.replace(found, folder=out / found.folder.name)


def _say_what_time(found: Calibration, say: Callable[[str], None]) -> None:
    """Say which offsets the person told better than they were known."""
    told = found.record["time"]
    cameras = told["cameras"] if told is not None and told["moved"] else {}
    for (name, one), offset in zip(cameras.items(), found.offsets, strict=False):
        late, deviation = 1000 * one["late_seconds"], 1000 * one["deviation_seconds"]
        if abs(late) >= 1:
            say(
                f"{name} began {abs(late):.0f} ms {'later' if late > 0 else 'earlier'} than its offset said "
                f"(± {deviation:.0f} ms), as the person's motion shows: offset is {offset:g} now."
            )


def _say_if_unsynchronised(path: str | Path, say: Callable[[str], None]) -> None:
    """Frames are paired by time: say when nothing tells it. What is wrong with the file is said by who opens it."""
    file = config_path(path)
    config, _ = read_config(file)
    if config is None or (file.parent / SYNC_REPORT).exists():
        return
    if not any("offset" in camera.model_fields_set for camera in config.camera):
        say(
            f"{file} has no offset of any camera: the videos are taken to start at the same moment; if they do not, "
            f"stop and run jaxmocap sync {file.parent} first."
        )
