"""The poses of a COLMAP model by camera and frame: its images are named `<camera>/<frame>.png`."""

from collections.abc import Sequence
from pathlib import PurePosixPath

import numpy as np

from jaxmocap._results import InputError

from ._colmap import ColmapModel, intrinsics_of

_QUATERNION_TOLERANCE = 1e-3


def ranges(frames: Sequence[int]) -> str:
    """Frame numbers as a reader would say them: `3, 12-14`."""
    runs: list[list[int]] = []
    for frame in sorted(frames):
        if runs and frame == runs[-1][1] + 1:
            runs[-1][1] = frame
        else:
            runs.append([frame, frame])
    return ", ".join(str(a) if a == b else f"{a}-{b}" for a, b in runs)


def _images_by_frame(model: ColmapModel, names: tuple[str, ...]) -> dict[str, dict[int, int]]:
    """For each of our cameras, frame number -> index of the model's image."""
    found: dict[str, dict[int, int]] = {name: {} for name in names}
    others = set()
    for index, image in enumerate(model.images):
        path = PurePosixPath(image.name.replace("\\", "/"))
        camera = path.parent.as_posix()
        if camera not in found:
            others.add(camera)
            continue
        if not path.stem.isdecimal():
            raise InputError(
                f"{model.images_file}: image {image.name} is not named by its frame; expected {camera}/00000.png, with "
                "the number of the frame in that camera's video, counted from 0"
            )
        if int(path.stem) in found[camera]:
            raise InputError(f"{model.images_file} has two poses for {camera} frame {int(path.stem)}")
        found[camera][int(path.stem)] = index
    missing = [name for name in names if not found[name]]
    if missing:
        raise InputError(
            f"{model.images_file} has no images of {', '.join(missing)}; its cameras are: "
            f"{', '.join(sorted(others | {name for name in names if found[name]})) or 'none'}. Images must be named "
            "<camera>/<frame>.png with the camera names of capture.toml"
        )
    return found


def _check_coverage(model: ColmapModel, found: dict[str, dict[int, int]], frames: np.ndarray) -> None:
    gaps, hint = [], ""
    for name, wanted in zip(found, frames, strict=True):
        missing = sorted({int(frame) for frame in wanted} - set(found[name]))
        if missing:
            gaps.append(f"{name} frame{'s' if len(missing) > 1 else ''} {ranges(missing)}")
            if missing == [0] and len(wanted) in found[name]:
                hint = "; the model seems to count from 1: number the images from 0"
    if gaps:
        raise InputError(
            f"{model.images_file} has no pose for {', nor for '.join(gaps)}; every frame of every camera needs one"
            + (hint or ": calibrate again, or shorten the capture")
        )


def _rotation(quaternion: np.ndarray, where: str) -> np.ndarray:
    from scipy.spatial.transform import Rotation

    length = np.linalg.norm(quaternion)
    if not np.isfinite(length) or abs(length - 1) > _QUATERNION_TOLERANCE:
        raise InputError(f"{where}: the quaternion {quaternion.tolist()} has length {length:.4g}; expected 1")
    return Rotation.from_quat(quaternion[[1, 2, 3, 0]]).as_matrix()


def from_colmap(model: ColmapModel, names: tuple[str, ...], frames: np.ndarray) -> tuple[list, np.ndarray]:
    """Per camera (size, K, distortion, where the model says so), and poses (camera, frame, 4, 4) in the model's units.

    `frames (camera, frame)` are the numbers of the images.
    """
    found = _images_by_frame(model, names)
    _check_coverage(model, found, frames)
    cameras = []
    poses = np.tile(np.eye(4), (*frames.shape, 1, 1))
    for index, name in enumerate(names):
        used = {}
        for step, frame in enumerate(frames[index]):
            image = model.images[found[name][int(frame)]]
            where = f"{model.images_file}: {name} frame {int(frame)}"
            if image.camera_id not in model.cameras:
                raise InputError(
                    f"{where} refers to camera {image.camera_id}, which {model.cameras_file} does not have"
                )
            used.setdefault(model.cameras[image.camera_id], image.camera_id)
            poses[index, step, :3, :3] = _rotation(np.asarray(image.quaternion), where)
            poses[index, step, :3, 3] = image.translation
            if not np.isfinite(poses[index, step]).all():
                raise InputError(f"{where}: the translation {list(image.translation)} is not finite")
        if len(used) > 1:
            ids = ", ".join(str(value) for value in used.values())
            raise InputError(
                f"{model.cameras_file} gives {name} several sets of intrinsics (cameras {ids}); expected one per "
                "video: calibrate with one shared camera for each video, and do not zoom"
            )
        camera = next(iter(used))
        where = f"{model.cameras_file} camera {name}"
        cameras.append((camera.size, *intrinsics_of(camera, where), where))
    return cameras, poses
