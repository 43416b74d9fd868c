"""Reading camera files of any supported kind, and refusing those that cannot be true."""

from collections.abc import Sequence
from pathlib import Path, PurePosixPath

import jax.numpy as jnp
import numpy as np

from jaxmocap._results import InputError

from ._calibration_toml import read_calibration_toml
from ._cameras import Cameras
from ._colmap import ColmapModel, colmap_files, intrinsics_of, read_colmap

_QUATERNION_TOLERANCE = 1e-3
_FARTHEST_APART = 100.0  # metres between two cameras that film one person
_FARTHEST_FROM_ORIGIN = 1000.0
_NEAREST_APART = 0.005


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


def _from_colmap(model: ColmapModel, names: tuple[str, ...], frames: np.ndarray) -> tuple[list, np.ndarray, np.ndarray]:
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
    return cameras, poses, frames


def _check_intrinsics(size: tuple[int, int], video: tuple[int, int] | None, k: np.ndarray, d: np.ndarray, where: str):
    if not (np.isfinite(k).all() and np.isfinite(d).all()):
        raise InputError(f"{where}: focal lengths, principal point and distortion must be finite numbers")
    if k[0, 0] == 0 or k[1, 1] == 0:
        raise InputError(f"{where}: the focal length is 0; expected pixels, about the width of the image")
    if k[0, 0] < 0 or k[1, 1] < 0:
        raise InputError(
            f"{where}: the focal lengths {k[0, 0]:g} and {k[1, 1]:g} mirror the image; both must be positive, with x "
            "to the right, y down and z forward (OpenGL and Blender look along -z: turn those by 180 degrees about x)"
        )
    if video is not None and size != video:
        hint = "; the sides are swapped: was the calibration made before the video was turned?" * (size == video[::-1])
        raise InputError(
            f"{where} is calibrated for {size[0]}x{size[1]} pixels, but its video has {video[0]}x{video[1]}{hint}"
        )


def _check_rotation(rotation: np.ndarray, where: str) -> None:
    if not np.isfinite(rotation).all():
        raise InputError(f"{where}: the rotation is not finite")
    if np.linalg.det(rotation) < 0:
        raise InputError(
            f"{where}: the rotation has determinant {np.linalg.det(rotation):.3g}, a mirrored camera; expected +1: one "
            "axis is flipped between the calibration's world and a right-handed one"
        )
    error = np.abs(rotation @ rotation.T - np.eye(3)).max()
    if error > _QUATERNION_TOLERANCE:
        raise InputError(f"{where}: the rotation matrix is not orthonormal (off by {error:.3g})")


def _check_scale(poses: np.ndarray, names: tuple[str, ...], label: str, metres_per_unit: float) -> None:
    """Two cameras that film one person stand centimetres to tens of metres apart: other distances are other units."""
    if not np.isfinite(poses).all():
        raise InputError(f"{label}: a translation is not finite")
    centres = -np.einsum("ctji,ctj->cti", poses[..., :3, :3], poses[..., :3, 3])
    units = {1.0: "metres", 0.01: "centimetres", 0.001: "millimetres"}.get(metres_per_unit, "its units")
    for first in range(len(names)):
        for second in range(first + 1, len(names)):
            apart = float(np.median(np.linalg.norm(centres[first] - centres[second], axis=-1)))
            if apart > _FARTHEST_APART:
                guess = "millimetres" if apart > 500 else "centimetres"
                raise InputError(
                    f"{label}: {names[first]} and {names[second]} are {apart:.0f} m apart when read in {units}, which "
                    f'looks like {guess}: set units = "{guess}" in capture.toml'
                )
            if apart < _NEAREST_APART and metres_per_unit < 1:
                raise InputError(
                    f"{label}: {names[first]} and {names[second]} are {1000 * apart:.2g} mm apart when read in "
                    f'{units}, which looks like metres: set units = "metres" in capture.toml'
                )
    farthest = np.linalg.norm(poses[..., :3, 3], axis=-1).max(axis=1)
    if farthest.max() > _FARTHEST_FROM_ORIGIN:
        name = names[int(farthest.argmax())]
        raise InputError(
            f"{label}: {name} is {farthest.max():.0f} m from the world's origin when read in {units}, which looks like "
            "millimetres or map coordinates: set units in capture.toml, or move the origin to the scene"
        )


def read_cameras(
    path: Path,
    names: Sequence[str],
    num_frames: int,
    sizes: Sequence[tuple[int, int]] | None = None,
    frames: np.ndarray | None = None,
    metres_per_unit: float = 1.0,
) -> Cameras:
    """Read the cameras called `names` from a COLMAP model (text or binary) or an aniposelib / Pose2Sim TOML.

    `frames (camera, frame)` are the frame numbers in each camera's own video (default 0, 1, ... for all); `sizes` the
    videos' (width, height), which must be the calibration's. Lengths are multiplied by `metres_per_unit`. The kind of
    file is told by its content. Raises `InputError` naming file, camera and frames for poses that are missing, not
    finite, mirrored or in other units, for focal lengths that are not positive, and for damaged files.
    """
    path, names = Path(path), tuple(names)
    if frames is None:
        frames = np.tile(np.arange(num_frames), (len(names), 1))
    folder = path.parent if path.name in ("cameras.txt", "cameras.bin", "images.txt", "images.bin") else path
    files = colmap_files(folder)
    if files is not None:
        cameras, poses, _ = _from_colmap(read_colmap(*files), names, np.asarray(frames))
    elif path.is_file():
        found = read_calibration_toml(path, names)
        cameras = [
            (
                camera.size or (sizes[i] if sizes else (0, 0)),
                camera.intrinsics,
                camera.distortion,
                f"{path.name} camera {n}",
            )
            for i, (n, camera) in enumerate(zip(names, found, strict=True))
        ]
        poses = np.stack([camera.cam_from_world for camera in found])[:, None]
    elif path.is_dir():
        inside = sorted(item.name for item in path.iterdir())[:6]
        raise InputError(
            f"{path.name}/ holds no COLMAP model; expected cameras.txt and images.txt, or cameras.bin and images.bin, "
            f"found {', '.join(inside) or 'nothing'}"
        )
    else:
        raise InputError(f"{path.name} does not exist; expected a COLMAP model folder or a calibration TOML")
    for index, (size, k, d, where) in enumerate(cameras):
        _check_intrinsics(size, sizes[index] if sizes else None, k, d, where)
        for rotation in poses[index, :, :3, :3]:
            _check_rotation(rotation, where)
    poses = poses.copy()
    poses[..., :3, 3] *= metres_per_unit
    _check_scale(poses, names, path.name, metres_per_unit)
    return Cameras(
        names,
        tuple(camera[0] for camera in cameras),
        jnp.asarray(np.stack([camera[1] for camera in cameras]), jnp.float32),
        jnp.asarray(np.stack([camera[2] for camera in cameras]), jnp.float32),
        jnp.asarray(np.broadcast_to(poses, (*frames.shape, 4, 4)), jnp.float32),
    )
