"""Cameras from and to COLMAP models, whose images are named `<camera>/<frame>.png`."""

import struct
from collections.abc import Sequence
from pathlib import Path, PurePosixPath
from typing import NamedTuple

import numpy as np
from jaxtyping import Int

from jaxmocap._results import InputError

from ._cameras import Cameras
from ._colmap import MODELS, ColmapModel, intrinsics_of

_QUATERNION_TOLERANCE = 1e-3


def ranges(frames: Sequence[int]) -> str:
    """Write frame numbers as a reader would say them: `3, 12-14`."""
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
    """Read per camera (size, K, distortion, where the model says so), and the poses.

    Poses are (camera, frame, 4, 4), in the model's units.

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


class _Image(NamedTuple):
    quaternion: np.ndarray  # w x y z
    translation: np.ndarray
    camera_id: int
    name: str


def _camera_models(cameras: Cameras) -> list[tuple[str, tuple[int, int], list[float]]]:
    """Per camera its model, size and parameters: PINHOLE, OPENCV, or FULL_OPENCV where there is a k3."""
    intrinsics, distortion = np.asarray(cameras.intrinsics, float), np.asarray(cameras.distortion, float)
    described = []
    for index, size in enumerate(cameras.sizes):
        k = intrinsics[index]
        if k[0, 1] != 0:
            raise InputError(f"camera {cameras.names[index]} has skew {k[0, 1]:g}, which a COLMAP model cannot hold")
        values = [k[0, 0], k[1, 1], k[0, 2], k[1, 2]]
        model = "PINHOLE"
        if distortion[index].any():
            third = distortion[index, 4] != 0
            model = "FULL_OPENCV" if third else "OPENCV"
            values += [*distortion[index, :4], *([distortion[index, 4], 0.0, 0.0, 0.0] if third else [])]
        described.append((model, size, values))
    return described


def _images(cameras: Cameras, frames: Int[np.ndarray, "camera frame"]) -> list[_Image]:
    """One image per camera and frame number; a frame that is shown twice, in one pose, is written once."""
    from scipy.spatial.transform import Rotation

    poses = np.asarray(cameras.cam_from_world, float)
    images = []
    for index, name in enumerate(cameras.names):
        quaternions = Rotation.from_matrix(poses[index, :, :3, :3]).as_quat(canonical=True)[..., [3, 0, 1, 2]]
        numbers, first, again = np.unique(frames[index], return_index=True, return_inverse=True)
        if not np.array_equal(poses[index], poses[index, first[again]]):
            raise InputError(f"frames gives camera {name} different poses at one of the frames {numbers.tolist()[:9]}")
        for step in first:
            file = f"{name}/{int(frames[index, step]):05d}.png"
            images.append(_Image(quaternions[step], poses[index, step, :3, 3], index + 1, file))
    return images


def write_colmap_text(
    cameras: Cameras, folder: Path, first_frame: int = 0, frames: Int[np.ndarray, "camera frame"] | None = None
) -> None:
    """Write a COLMAP text model with one image per camera and frame, named `<camera>/<frame:05d>.png`, and no points.

    Metres, world to camera, centre of the first pixel at (0.5, 0.5). The frames are numbered from `first_frame`, or by
    `frames`. `read_cameras` reads it back.
    """
    folder = Path(folder)
    lines = [
        f"{index + 1} {model} {width} {height} " + " ".join(f"{value:.9g}" for value in values)
        for index, (model, (width, height), values) in enumerate(_camera_models(cameras))
    ]
    images = []
    for image in _images(cameras, _frame_numbers(cameras, first_frame) if frames is None else frames):
        values = " ".join(f"{value:.9f}" for value in (*image.quaternion, *image.translation))
        images.append(f"{len(images) + 1} {values} {image.camera_id} {image.name}\n")
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "cameras.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")
    (folder / "images.txt").write_text("\n".join(images) + "\n", encoding="utf-8")
    (folder / "points3D.txt").write_text("", encoding="utf-8")


def write_colmap_binary(cameras: Cameras, folder: Path, frames: Int[np.ndarray, "camera frame"] | None = None) -> None:
    """Write what `write_colmap_text` does in COLMAP's binary form, which keeps every digit."""
    folder = Path(folder)
    described = _camera_models(cameras)
    number = {name: model for model, (name, _) in MODELS.items()}
    head = [struct.pack("<Q", len(described))]
    for index, (model, size, values) in enumerate(described):
        head.append(struct.pack(f"<IiQQ{len(values)}d", index + 1, number[model], *size, *values))
    images = _images(cameras, _frame_numbers(cameras, 0) if frames is None else frames)
    body = [struct.pack("<Q", len(images))]
    for index, image in enumerate(images):
        pose = struct.pack("<I7dI", index + 1, *image.quaternion, *image.translation, image.camera_id)
        body.append(pose + image.name.encode() + b"\0" + struct.pack("<Q", 0))
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "cameras.bin").write_bytes(b"".join(head))
    (folder / "images.bin").write_bytes(b"".join(body))
    (folder / "points3D.bin").write_bytes(struct.pack("<Q", 0))


def _frame_numbers(cameras: Cameras, first: int) -> Int[np.ndarray, "camera frame"]:
    return np.tile(np.arange(first, first + cameras.num_frames), (cameras.num_cameras, 1))
