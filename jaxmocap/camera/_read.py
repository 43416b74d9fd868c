"""Reading camera files of any supported kind, and refusing those that cannot be true."""

from collections.abc import Sequence
from pathlib import Path, PurePosixPath
from typing import NamedTuple

import jax
import numpy as np

from jaxmocap._results import InputError

from ._calibration_toml import read_calibration_toml
from ._cameras import Cameras
from ._colmap import colmap_files, read_colmap
from ._colmap_cameras import from_colmap
from ._easymocap import FILES as EASYMOCAP_FILES, easymocap_files, read_easymocap
from ._file_storage import read_storage
from ._opencv_storage import SUFFIXES, opencv_files, read_opencv, read_opencv_files
from ._plausibility import intrinsics_problems, rotation_problem, scale_problem
from ._qualisys import MILLIMETRE, read_qualisys
from ._static_camera import StaticCamera, read_text


def _static_files(path: Path, names: tuple[str, ...]) -> tuple[list[StaticCamera], float | None]:
    """Read static cameras from a calibration told by its content, and metres per unit where its form settles that."""
    if path.is_dir():
        pair = easymocap_files(path)
        if pair is not None:
            return read_easymocap(pair, names), None
        files = opencv_files(path, names)
        if files is not None:
            return read_opencv_files(files, names), None
        inside = sorted(item.name for item in path.iterdir())[:6]
        raise InputError(
            f"{path.name}/ holds no COLMAP model; expected cameras.txt and images.txt, or cameras.bin and images.bin, "
            "or EasyMocap's intri.yml and extri.yml, or a file of OpenCV's per camera, named after it, found "
            f"{', '.join(inside) or 'nothing'}"
        )
    if not path.is_file():
        raise InputError(
            f"{path.name} does not exist; expected a COLMAP model folder or a calibration of aniposelib, Pose2Sim, "
            "FreeMoCap, EasyMocap, Qualisys or OpenCV"
        )
    text = read_text(path, path.name)
    begin = text.lstrip()[:1]
    if begin == "<" and "<opencv_storage" not in text:
        return read_qualisys(text, names, path.name), MILLIMETRE
    if begin in ("<", "{", "%") or path.suffix.lower() in SUFFIXES:
        document = read_storage(text, path.name)
        if path.name in EASYMOCAP_FILES and "names" in document:
            pair = easymocap_files(path.parent)
            assert pair is not None
            return read_easymocap(pair, names), None
        return read_opencv(document, names, path.name), None
    return read_calibration_toml(text, names, path.name)


class _Loaded(NamedTuple):
    """Per camera (size, K, distortion, where it says so); poses (camera, frame or 1, 4, 4) in the file's units; and
    metres per unit where the form of the file settles it."""

    cameras: list[tuple[tuple[int, int], np.ndarray, np.ndarray, str]]
    poses: np.ndarray
    metres_per_unit: float | None


def _folder(path: Path) -> Path:
    """Return the folder of a COLMAP model of which a file is named."""
    return path.parent if path.name in ("cameras.txt", "cameras.bin", "images.txt", "images.bin") else path


def _load(path: Path, names: tuple[str, ...], sizes: Sequence[tuple[int, int]] | None, frames: np.ndarray) -> _Loaded:
    files = colmap_files(_folder(path))
    if files is not None:
        return _Loaded(*from_colmap(read_colmap(*files), names, frames), None)
    static, unit = _static_files(path, names)
    described = [
        (
            camera.size or (sizes[i] if sizes else (0, 0)),
            camera.intrinsics,
            camera.distortion,
            f"{path.name} camera {name}",
        )
        for i, (name, camera) in enumerate(zip(names, static, strict=True))
    ]
    return _Loaded(described, np.stack([camera.cam_from_world for camera in static])[:, None], unit)


def examine_cameras(
    path: Path,
    names: Sequence[str],
    num_frames: int,
    sizes: Sequence[tuple[int, int]] | None = None,
    frames: np.ndarray | None = None,
    metres_per_unit: float = 1.0,
) -> tuple[Cameras, list[str]]:
    """Read as `read_cameras` does, but return cameras that cannot be true with sentences that say why."""
    path, names = Path(path), tuple(names)
    frames = np.tile(np.arange(num_frames), (len(names), 1)) if frames is None else np.asarray(frames)
    loaded = _load(path, names, sizes, frames)
    return _examined(loaded, path.name, names, sizes, frames.shape, metres_per_unit)


def read_picture_cameras(
    path: Path, pictures: Sequence[str], size: tuple[int, int], any_scale: bool = False
) -> Cameras:
    """Read the cameras of single pictures, one camera each: a COLMAP model's images with these file names, or static
    cameras called like them without the ending.

    With `any_scale` lengths need not be metres. Raises `InputError` as `read_cameras` does.
    """
    names, sizes = tuple(Path(picture).stem for picture in pictures), [size] * len(pictures)
    frames = np.zeros((len(names), 1), int)
    files = colmap_files(_folder(path))
    if files is None:
        loaded = _load(path, names, sizes, frames)
    else:
        model = read_colmap(*files)
        places = {PurePosixPath(image.name.replace("\\", "/")).name: image for image in model.images}
        missing = [picture for picture in pictures if picture not in places]
        if missing:
            raise InputError(
                f"{model.images_file} has no image {', '.join(missing[:5])}; its images are "
                f"{', '.join(sorted(places)[:5])} and so on: the names must be those of the pictures, ending included"
            )
        images = [places[one]._replace(name=f"{name}/0.png") for one, name in zip(pictures, names, strict=True)]
        loaded = _Loaded(*from_colmap(model._replace(images=images), names, frames), None)
    cameras, problems = _examined(loaded, path.name, names, sizes, frames.shape, None if any_scale else 1.0)
    if problems:
        raise InputError(problems[0])
    return cameras


def _examined(
    loaded: _Loaded,
    label: str,
    names: tuple[str, ...],
    sizes: Sequence[tuple[int, int]] | None,
    shape: tuple[int, ...],
    metres_per_unit: float | None,
) -> tuple[Cameras, list[str]]:
    """Make cameras of what was loaded, and say why they cannot be true; without a unit their scale is not looked at."""
    cameras, poses, unit = loaded
    scale = (metres_per_unit or 1.0) if unit is None else unit
    problems: list[str] = []
    for index, (size, k, d, where) in enumerate(cameras):
        problems += intrinsics_problems(size, sizes[index] if sizes else None, k, d, where)
        wrong = [rotation_problem(pose[:3, :3], where) for pose in poses[index]]
        problems += [sentence for sentence in wrong if sentence][:1]
        if not np.isfinite(poses[index, :, :3, 3]).all():
            problems.append(f"{where}: the translation is not finite")
    poses = poses.copy()
    poses[..., :3, 3] *= scale
    if not problems and metres_per_unit is not None:
        problems += scale_problem(poses, names, label, scale, fixed=unit is not None)
    with np.errstate(over="ignore"):  # of numbers that are among the problems
        result = Cameras(
            names,
            tuple(camera[0] for camera in cameras),
            jax.device_put(np.stack([camera[1] for camera in cameras]).astype(np.float32)),
            jax.device_put(np.stack([camera[2] for camera in cameras]).astype(np.float32)),
            jax.device_put(np.broadcast_to(poses, (*shape, 4, 4)).astype(np.float32)),
        )
    return result, problems


def read_cameras(
    path: Path,
    names: Sequence[str],
    num_frames: int,
    sizes: Sequence[tuple[int, int]] | None = None,
    frames: np.ndarray | None = None,
    metres_per_unit: float = 1.0,
) -> Cameras:
    """Read the cameras called `names` from a COLMAP model (text or binary) or a calibration of aniposelib, Pose2Sim,
    FreeMoCap, EasyMocap, Qualisys or OpenCV (`write_cameras` lists the forms).

    `frames (camera, frame)` are the frame numbers in each camera's own video (default 0, 1, ... for all); `sizes` the
    videos' (width, height), which must be the calibration's. Lengths are multiplied by `metres_per_unit`, except those
    of Qualisys and FreeMoCap, which are millimetres. The kind of file is told by its content; pickles are never loaded.
    Raises `InputError` naming file, camera and frames for poses that are missing, not finite, mirrored or in other
    units, for focal lengths that are not positive, and for damaged files.
    """
    cameras, problems = examine_cameras(path, names, num_frames, sizes, frames, metres_per_unit)
    if problems:
        raise InputError(problems[0])
    return cameras
