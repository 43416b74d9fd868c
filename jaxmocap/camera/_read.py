"""Reading camera files of any supported kind, and refusing those that cannot be true."""

from collections.abc import Sequence
from pathlib import Path, PurePosixPath

import jax.numpy as jnp
import numpy as np

from jaxmocap._results import InputError

from ._calibration_toml import read_calibration_toml
from ._cameras import Cameras
from ._colmap import ColmapModel, colmap_files, intrinsics_of, read_colmap
from ._plausibility import intrinsics_problems, rotation_problem, scale_problem

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


def _from_colmap(model: ColmapModel, names: tuple[str, ...], frames: np.ndarray) -> tuple[list, np.ndarray]:
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


def _from_toml(path: Path, names: tuple[str, ...], sizes: Sequence[tuple[int, int]] | None) -> tuple[list, np.ndarray]:
    cameras = read_calibration_toml(path, names)
    described = [
        (
            camera.size or (sizes[i] if sizes else (0, 0)),
            camera.intrinsics,
            camera.distortion,
            f"{path.name} camera {name}",
        )
        for i, (name, camera) in enumerate(zip(names, cameras, strict=True))
    ]
    return described, np.stack([camera.cam_from_world for camera in cameras])[:, None]


def _load(
    path: Path, names: tuple[str, ...], sizes: Sequence[tuple[int, int]] | None, frames: np.ndarray
) -> tuple[list, np.ndarray]:
    """Per camera (size, K, distortion, where it says so), and poses (camera, frame or 1, 4, 4) in the file's units."""
    folder = path.parent if path.name in ("cameras.txt", "cameras.bin", "images.txt", "images.bin") else path
    files = colmap_files(folder)
    if files is not None:
        return _from_colmap(read_colmap(*files), names, frames)
    if path.is_file():
        return _from_toml(path, names, sizes)
    if path.is_dir():
        inside = sorted(item.name for item in path.iterdir())[:6]
        raise InputError(
            f"{path.name}/ holds no COLMAP model; expected cameras.txt and images.txt, or cameras.bin and images.bin, "
            f"found {', '.join(inside) or 'nothing'}"
        )
    raise InputError(f"{path.name} does not exist; expected a COLMAP model folder or a calibration TOML")


def examine_cameras(
    path: Path,
    names: Sequence[str],
    num_frames: int,
    sizes: Sequence[tuple[int, int]] | None = None,
    frames: np.ndarray | None = None,
    metres_per_unit: float = 1.0,
) -> tuple[Cameras, list[str]]:
    """As `read_cameras`, but cameras that cannot be true are returned with sentences that say why."""
    path, names = Path(path), tuple(names)
    frames = np.tile(np.arange(num_frames), (len(names), 1)) if frames is None else np.asarray(frames)
    cameras, poses = _load(path, names, sizes, frames)
    problems: list[str] = []
    for index, (size, k, d, where) in enumerate(cameras):
        problems += intrinsics_problems(size, sizes[index] if sizes else None, k, d, where)
        wrong = [rotation_problem(pose[:3, :3], where) for pose in poses[index]]
        problems += [sentence for sentence in wrong if sentence][:1]
    poses = poses.copy()
    poses[..., :3, 3] *= metres_per_unit
    if not problems:
        problems += scale_problem(poses, names, path.name, metres_per_unit)
    result = Cameras(
        names,
        tuple(camera[0] for camera in cameras),
        jnp.asarray(np.stack([camera[1] for camera in cameras]), jnp.float32),
        jnp.asarray(np.stack([camera[2] for camera in cameras]), jnp.float32),
        jnp.asarray(np.broadcast_to(poses, (*frames.shape, 4, 4)), jnp.float32),
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
    """Read the cameras called `names` from a COLMAP model (text or binary) or an aniposelib / Pose2Sim TOML.

    `frames (camera, frame)` are the frame numbers in each camera's own video (default 0, 1, ... for all); `sizes` the
    videos' (width, height), which must be the calibration's. Lengths are multiplied by `metres_per_unit`. The kind of
    file is told by its content. Raises `InputError` naming file, camera and frames for poses that are missing, not
    finite, mirrored or in other units, for focal lengths that are not positive, and for damaged files.
    """
    cameras, problems = examine_cameras(path, names, num_frames, sizes, frames, metres_per_unit)
    if problems:
        raise InputError(problems[0])
    return cameras
