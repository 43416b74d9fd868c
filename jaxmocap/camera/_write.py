"""Writing cameras in the formats of other programs."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from jaxtyping import Int

from jaxmocap._files import atomic_folder, write_text
from jaxmocap._results import InputError

from ._calibration_toml import aniposelib_text, freemocap_text
from ._cameras import Cameras
from ._colmap_cameras import write_colmap_binary, write_colmap_text
from ._easymocap import easymocap_texts
from ._opencv_storage import SUFFIXES, opencv_text
from ._plausibility import intrinsics_problems, rotation_problem
from ._qualisys import qualisys_text
from ._static_camera import OPENCV_CENTRE, WrittenCamera

_TEXTS: dict[str, tuple[tuple[str, ...], Callable[[list[WrittenCamera], str], str]]] = {
    "aniposelib": ((".toml",), lambda cameras, _: aniposelib_text(cameras)),
    "pose2sim": ((".toml",), lambda cameras, _: aniposelib_text(cameras)),
    "freemocap": ((".toml",), lambda cameras, _: freemocap_text(cameras)),
    "qualisys": ((".qca.txt", ".xml"), lambda cameras, _: qualisys_text(cameras)),
    "opencv": (SUFFIXES, opencv_text),
}
_FOLDERS = ("colmap", "colmap-binary", "easymocap")
FORMATS = (*_FOLDERS, *_TEXTS)
_STILL = 1e-6
"""Metres, and entries of a rotation: more than this between frames is a moving camera."""


def _check(cameras: Cameras) -> None:
    """Cameras that `read_cameras` would refuse are not written."""
    intrinsics, distortion = np.asarray(cameras.intrinsics, float), np.asarray(cameras.distortion, float)
    poses = np.asarray(cameras.cam_from_world, float)
    if len(set(cameras.names)) < len(cameras.names):
        raise InputError(f"the cameras cannot be written: two have one name, among {', '.join(cameras.names)}")
    for index, (name, size) in enumerate(zip(cameras.names, cameras.sizes, strict=True)):
        where = f"camera {name}"
        problems = intrinsics_problems(size, None, intrinsics[index], distortion[index], where)
        problems += [sentence for pose in poses[index] if (sentence := rotation_problem(pose[:3, :3], where))]
        if not np.isfinite(poses[index]).all():
            problems.append(f"{where}: a translation is not finite")
        if min(size) < 1:
            problems.append(
                f"{where} has the size {size[0]}x{size[1]}; expected its video's width and height in pixels"
            )
        if problems:
            raise InputError(f"the cameras cannot be written: {problems[0]}")


def _static(cameras: Cameras, form: str) -> list[WrittenCamera]:
    """Describe each camera by one pose in OpenCV's convention. Raises `InputError` for one that moves or has skew."""
    poses, intrinsics = np.asarray(cameras.cam_from_world, float), np.array(cameras.intrinsics, float)
    moved = np.abs(poses - poses[:, :1]).max(axis=(1, 2, 3))
    if (moved > _STILL).any():
        index = int(moved.argmax())
        centres, turns = np.asarray(cameras.centres(), float)[index], poses[index, :, :3, :3]
        chord = np.linalg.norm(turns - turns[0], axis=(1, 2)).max() / np.sqrt(8)  # sine of half the angle
        raise InputError(
            f"the cameras cannot be written as {form}, which holds one pose per camera: {cameras.names[index]} moves "
            f"by up to {np.linalg.norm(centres - centres[0], axis=1).max():.3g} m and "
            f"{np.degrees(2 * np.arcsin(min(chord, 1.0))):.3g} degrees; write colmap, which has a pose per frame"
        )
    intrinsics[:, :2, 2] -= OPENCV_CENTRE
    written = []
    for index, name in enumerate(cameras.names):
        skew = intrinsics[index, 0, 1]
        if skew != 0:
            raise InputError(f"camera {name} has skew {skew:g}, which {form} cannot hold")
        pose = poses[index, 0]
        distortion = np.asarray(cameras.distortion[index], float)
        written.append(
            WrittenCamera(name, cameras.sizes[index], intrinsics[index], distortion, pose[:3, :3], pose[:3, 3])
        )
    return written


def write_cameras(
    cameras: Cameras, path: str | Path, format: str, frames: Int[np.ndarray, "camera frame"] | None = None
) -> Path:
    """Write cameras for another program, whole or not at all; `read_cameras` reads each form back. Returns `path`.

    | `format` | `path` | lengths | holds |
    |---|---|---|---|
    | `"colmap"`, `"colmap-binary"` | a new folder | metres | a pose per frame, numbered by `frames` |
    | `"aniposelib"`, `"pose2sim"` | `.toml` | metres | one pose per camera |
    | `"freemocap"` | `.toml` | millimetres | one pose per camera |
    | `"easymocap"` | a new folder: `intri.yml`, `extri.yml` | metres | one pose per camera |
    | `"qualisys"` | `.qca.txt` or `.xml` | millimetres | one pose per camera |
    | `"opencv"` | `.yml`, `.yaml`, `.xml` or `.json` | metres | one pose per camera |

    All but COLMAP put the centre of the first pixel at (0, 0): their principal points are half a pixel less than ours.
    `frames (camera, frame)` are the frame numbers in each camera's own video, as in `read_cameras` (default 0, 1, ...):
    give `capture.video_frames`. Raises `InputError` for an unknown format, a moving camera in a form for static ones,
    cameras that cannot be true, and a place where nothing can be written.
    """
    path = Path(path)
    if format not in FORMATS:
        raise InputError(f"cameras cannot be written as {format!r}; expected one of {', '.join(FORMATS)}")
    _check(cameras)
    shape = (cameras.num_cameras, cameras.num_frames)
    if frames is not None and np.shape(frames) != shape:
        raise InputError(f"frames has shape {np.shape(frames)}; expected a number per camera and per frame, {shape}")
    try:
        if format in _TEXTS:
            suffixes, text = _TEXTS[format]
            suffix = next((one for one in suffixes if path.name.lower().endswith(one)), None)
            if suffix is None:
                raise InputError(
                    f"{path} cannot hold {format} cameras; expected a file name with {' or '.join(suffixes)}"
                )
            write_text(path, text(_static(cameras, format), suffix))
        else:
            _write_folder(cameras, path, format, frames)
    except OSError as error:
        raise InputError(f"cameras cannot be written to {path}: {error.strerror}; choose another place") from error
    return path


def _write_folder(cameras: Cameras, path: Path, form: str, frames: Int[np.ndarray, "camera frame"] | None) -> None:
    if path.exists() and (not path.is_dir() or any(path.iterdir())):
        raise InputError(f"{path} exists already; {form} is a folder of files: choose a new or an empty folder")
    texts = easymocap_texts(_static(cameras, form)) if form == "easymocap" else {}
    with atomic_folder(path) as folder:
        for name, text in texts.items():
            (folder / name).write_text(text, encoding="utf-8")
        if form == "colmap":
            write_colmap_text(cameras, folder, frames=frames)
        elif form == "colmap-binary":
            write_colmap_binary(cameras, folder, frames)
