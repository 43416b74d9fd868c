"""Refined cameras for a capture on disk: a new model beside the old one, and the lines of `capture.toml`."""

import dataclasses
import json
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from jaxmocap._files import atomic_folder, write_json, write_text
from jaxmocap._results import InputError
from jaxmocap.capture import Capture, config_path, with_cameras_line, with_offsets
from jaxmocap.motion import Motion

from ._child import run_worker
from ._in_place import free_name
from ._refine import RefinedCameras, refine

REPORT = "refinement.json"


def refine_cameras(
    capture: Capture | str | Path,
    motion: Motion | str | Path,
    *,
    detections: str | Path | None = None,
    progress: Callable[[str, int, int], None] = lambda stage, done, total: None,
) -> RefinedCameras:
    """Refine the cameras of a capture, and when its videos began to a part of a frame, by the background and the
    tracked body together.

    `motion` is a result of tracking the capture, or its folder. The body is seen in keypoints at tracked frames, the
    capture's or those of a folder of `detections` (OpenPose BODY_25, named like the capture's); the background in the
    points of the COLMAP model, as `calibrate` writes it. Where there are none, static cameras from a file for example,
    cameras are held and only the offsets are refined. With an open `Capture` nothing is written; with a folder or
    `capture.toml` the refined model becomes a new folder in it with `refinement.json`, which `cameras` names then, and
    each `offset` is set; the old cameras stay on disk.

    Raises `InputError`, with nothing changed on disk, where the result is not of this capture and these cameras, where
    two views have too few keypoints, and where the videos are too far apart in time to be refined.
    """
    if not isinstance(motion, Motion):
        motion = Motion.load(motion)
    if isinstance(capture, Capture):
        return refine(capture, motion, detections=detections, progress=progress)
    file = config_path(capture)
    opened = Capture.open(file)
    found = refine(opened, motion, detections=detections, progress=progress)
    try:
        return _write(opened, file, found, progress)
    except OSError as error:
        raise InputError(f"{file.parent} cannot be written to: {error.strerror}; nothing was changed") from error


def _write(
    capture: Capture, file: Path, found: RefinedCameras, progress: Callable[[str, int, int], None]
) -> RefinedCameras:
    text = with_offsets(_text(file), found.offsets, file)
    if not found.names:
        write_json(file.parent / REPORT, found.record)
        write_text(file, text)
        return found
    folder = free_name(file.parent, "cameras")
    assert capture.cameras_path is not None
    model = capture.cameras_path if capture.cameras_path.is_dir() else capture.cameras_path.parent
    poses = found.poses.copy()
    poses[:, :3, 3] /= capture.metres_per_unit
    with tempfile.TemporaryDirectory(prefix="jaxmocap-") as temporary, atomic_folder(folder) as partial:
        work = Path(temporary)
        (work / "model.json").write_text(json.dumps(str(model.resolve())), encoding="utf-8")
        np.savez(
            work / "poses.npz",
            names=np.array(found.names, np.str_),
            cam_from_world=poses,
            cameras=np.array(capture.camera_names, np.str_),
            factors=found.focal_factors,
        )
        run_worker("poses", work, progress)
        shutil.copytree(work / "cameras", partial, dirs_exist_ok=True)
        write_json(partial / REPORT, found.record)
    write_text(file, with_cameras_line(text, folder.name, file))
    return dataclasses.replace(found, folder=folder)


def _text(file: Path) -> str:
    return file.read_bytes().decode("utf-8")  # not read_text, which would change line ends
