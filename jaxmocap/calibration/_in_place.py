"""Cameras of a capture on disk, calibrated, adopted or refined: a new folder, and the lines in `capture.toml`."""

import dataclasses
import json
import os
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from jaxmocap._files import atomic_folder, atomic_path, free_name, write_json, write_text
from jaxmocap._results import InputError
from jaxmocap.camera import read_cameras
from jaxmocap.capture import Capture, config_path, read_config, shared_frames, with_cameras_line, with_offsets
from jaxmocap.motion import Motion

from ._calibrate import Calibration, calibrate
from ._child import run_worker
from ._footage import Report
from ._refine import RefinedCameras, refine
from ._report import draw_cameras, png_bytes, rescaled

REPORT = "refinement.json"
_REPORTS = ("calibration.json", "uncertainty.json")


def calibrate_in_place(
    path: str | Path, *, replace: bool = False, naming: Callable[[str], None] = lambda name: None, **options: Any
) -> Calibration:
    """Calibrate the capture at `path`, write the result to a folder in it and name that in `capture.toml`, with the
    offsets where the person told them better and the frames that it names are still shared.

    Raises `InputError` if `capture.toml` names cameras already, unless `replace`; the old ones stay where they are.
    `naming` is told the folder's name before `capture.toml` gets it. `options` are those of `calibrate`.
    """
    file = refuse_named_cameras(path, replace)
    capture = Capture.open(file, with_cameras=False)
    folder = free_name(file.parent, "cameras")
    calibration = calibrate(capture, **options)
    if not _opens_with(calibration.offsets, capture, file):
        time = {**calibration.record["time"], "moved": False}
        calibration = dataclasses.replace(
            calibration, offsets=capture.offsets, record={**calibration.record, "time": time}
        )
    calibration.save(folder)
    naming(folder.name)
    text = with_cameras_line(_text(file), folder.name, file)
    if calibration.offsets != capture.offsets:
        text = with_offsets(text, calibration.offsets, file)
    write_text(file, text)
    return dataclasses.replace(calibration, folder=folder)


def _opens_with(offsets: tuple[float, ...], capture: Capture, file: Path) -> bool:
    """Tell whether the capture can be opened with other offsets: the frames that its lines name are still shared."""
    if offsets == capture.offsets:
        return True
    config, _ = read_config(file)
    shared = shared_frames(capture.indices, offsets)[0]
    selected = capture.video_frames[0, list(capture.selected_frames or ())]
    fewer = config is not None and config.frames is not None and config.frames > len(shared)
    return not fewer and bool(np.isin(selected, shared).all())


def refuse_named_cameras(path: str | Path, replace: bool) -> Path:
    """Find the `capture.toml`. Raises `InputError` if it names cameras, unless `replace`, or cannot be written."""
    file = config_path(path)
    config, _ = read_config(file)
    if config is not None and config.cameras is not None and not replace:
        raise InputError(
            f"{file} names cameras already ({config.cameras!r}); remove the line, or use --replace, which leaves "
            "the old ones where they are"
        )
    if not os.access(file.parent, os.W_OK):
        raise InputError(f"{file.parent} cannot be written to; copy the capture to a place of your own")
    return file


def name_cameras(file: Path, name: str) -> None:
    """Set the line `cameras` in `capture.toml`."""
    write_text(file, with_cameras_line(_text(file), name, file))


def adopt_cameras(path: str | Path, cameras: str | Path, *, replace: bool = False) -> Path:
    """Copy a calibration of any form that `read_cameras` takes into the capture at `path` and name it there.

    Returns the copy. Raises `InputError`, with nothing changed, if it does not fit the capture's cameras, frames and
    video sizes, or if `capture.toml` names cameras already, unless `replace`; the old ones stay where they are.
    """
    file, source = refuse_named_cameras(path, replace), Path(cameras)
    capture = Capture.open(file, with_cameras=False)
    read_cameras(
        source, capture.camera_names, capture.num_frames, capture.sizes, capture.video_frames, capture.metres_per_unit
    )
    copy = free_name(file.parent, "cameras", "" if source.is_dir() else "".join(source.suffixes[-2:]))
    try:
        if source.is_dir():
            with atomic_folder(copy) as partial:
                shutil.copytree(source, partial, dirs_exist_ok=True)
        else:
            with atomic_path(copy) as partial:
                shutil.copyfile(source, partial)
        name_cameras(file, copy.name)
    except OSError as error:
        raise InputError(f"{copy} cannot be written: {error.strerror}") from error
    return copy


def refine_cameras(
    capture: Capture | str | Path,
    motion: Motion | str | Path,
    *,
    detections: str | Path | None = None,
    progress: Report = lambda stage, done, total: None,
) -> RefinedCameras:
    """Refine the cameras of a capture and the moments at which its videos began, with the body that was tracked.

    `motion` is a result of tracking the capture, or its folder. Background and body are adjusted together, and a moment
    is found to a part of a frame. The body is seen in keypoints at tracked frames, the capture's or those of a folder
    of `detections` (files as the capture's may be); the background in the points of the COLMAP model, as
    `calibrate` writes it. Where there are none, static cameras from a file for example, cameras are held and only the
    offsets are refined. With an open `Capture` nothing is written; with a folder or `capture.toml` the refined model
    becomes a new folder in it with `refinement.json`, which `cameras` names then, and each `offset` is set; the old
    cameras stay on disk.

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


def scale_cameras(path: str | Path, factor: float, *, progress: Report = lambda stage, done, total: None) -> Path:
    """Multiply all positions of a calibration by `factor`, as `CharacterFit.camera_scale` says it.

    `path` is a capture folder or its `capture.toml`. The scaled model becomes a new folder in it, which `cameras` names
    then, with the reports of `calibrate` where there are any, their lengths scaled alike; the old cameras stay on disk.
    Returns the new folder. Raises `InputError`, with nothing changed, where the factor is no positive number, the
    cameras are not a COLMAP model as `calibrate` writes it, or the folder cannot be written to.
    """
    return scale_in_place(path, factor, lambda name: None, progress)


def scale_in_place(path: str | Path, factor: float, naming: Callable[[str], None], progress: Report) -> Path:
    """Do what `scale_cameras` does; `naming` is told the new folder's name before `capture.toml` gets it."""
    if not (np.isfinite(factor) and factor > 0):
        raise InputError(f"the factor to scale cameras by is {factor:g}; a positive number was expected")
    file = refuse_named_cameras(path, replace=True)
    capture = Capture.open(file)
    source = capture.cameras_path
    if source is None or not (source / "cameras.bin").is_file():
        raise InputError(
            f"{file}: the cameras {source} are not a model that calibrate wrote, whose scale can be changed; leave it "
            f"as it is, or run jaxmocap calibrate {file.parent} --replace first"
        )
    folder = free_name(file.parent, "cameras")
    try:
        with tempfile.TemporaryDirectory(prefix="jaxmocap-") as temporary, atomic_folder(folder) as partial:
            work = Path(temporary)
            shutil.copytree(source, work / "model")
            similarity = {"scale": factor, "rotation": np.eye(3), "translation": np.zeros(3)}
            write_json(work / "similarity.json", similarity)
            run_worker("transform", work, progress)
            shutil.copytree(work / "cameras", partial, dirs_exist_ok=True)
            if all((source / name).is_file() for name in _REPORTS):
                record, table = (json.loads((source / name).read_text(encoding="utf-8")) for name in _REPORTS)
                for name, report in zip(_REPORTS, rescaled(record, table, factor), strict=True):
                    write_json(partial / name, report)
        with atomic_path(folder / "calibration.png") as picture:
            picture.write_bytes(png_bytes(draw_cameras(dataclasses.replace(capture, cameras_path=folder))))
        naming(folder.name)
        name_cameras(file, folder.name)
    except OSError as error:
        raise InputError(f"{folder} cannot be written: {error.strerror}") from error
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(
            f"{source}: {' and '.join(_REPORTS)} are not what calibrate writes ({type(error).__name__}: {error}); "
            f"remove them, or run jaxmocap calibrate {file.parent} --replace"
        ) from error
    return folder


def _write(capture: Capture, file: Path, found: RefinedCameras, progress: Report) -> RefinedCameras:
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
