"""Writing COLMAP models, text and binary: one image per camera and frame, and no points."""

import struct
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Int

from jaxmocap._results import InputError

from ._cameras import Cameras
from ._colmap import MODELS


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
    for image in _images(cameras, _numbers(cameras, first_frame) if frames is None else frames):
        values = " ".join(f"{value:.9f}" for value in (*image.quaternion, *image.translation))
        images.append(f"{len(images) + 1} {values} {image.camera_id} {image.name}\n")
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "cameras.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")
    (folder / "images.txt").write_text("\n".join(images) + "\n", encoding="utf-8")
    (folder / "points3D.txt").write_text("", encoding="utf-8")


def write_colmap_binary(cameras: Cameras, folder: Path, frames: Int[np.ndarray, "camera frame"] | None = None) -> None:
    """As `write_colmap_text`, in COLMAP's binary form, which keeps every digit."""
    folder = Path(folder)
    described = _camera_models(cameras)
    number = {name: model for model, (name, _) in MODELS.items()}
    head = [struct.pack("<Q", len(described))]
    for index, (model, size, values) in enumerate(described):
        head.append(struct.pack(f"<IiQQ{len(values)}d", index + 1, number[model], *size, *values))
    images = _images(cameras, _numbers(cameras, 0) if frames is None else frames)
    body = [struct.pack("<Q", len(images))]
    for index, image in enumerate(images):
        pose = struct.pack("<I7dI", index + 1, *image.quaternion, *image.translation, image.camera_id)
        body.append(pose + image.name.encode() + b"\0" + struct.pack("<Q", 0))
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "cameras.bin").write_bytes(b"".join(head))
    (folder / "images.bin").write_bytes(b"".join(body))
    (folder / "points3D.bin").write_bytes(struct.pack("<Q", 0))


def _numbers(cameras: Cameras, first: int) -> Int[np.ndarray, "camera frame"]:
    return np.tile(np.arange(first, first + cameras.num_frames), (cameras.num_cameras, 1))
