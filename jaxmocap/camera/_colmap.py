"""COLMAP models: a small bounded reader of the text and binary forms."""

import struct
from pathlib import Path
from typing import NamedTuple

import numpy as np

from jaxmocap._results import InputError


class ColmapCamera(NamedTuple):
    model: str
    size: tuple[int, int]
    parameters: tuple[float, ...]


class ColmapImage(NamedTuple):
    name: str
    quaternion: tuple[float, ...]  # w x y z
    translation: tuple[float, ...]
    camera_id: int


class ColmapModel(NamedTuple):
    cameras: dict[int, ColmapCamera]
    images: list[ColmapImage]
    cameras_file: str
    images_file: str


# COLMAP's numbering of camera models and how many parameters each has.
MODELS = {
    0: ("SIMPLE_PINHOLE", 3),
    1: ("PINHOLE", 4),
    2: ("SIMPLE_RADIAL", 4),
    3: ("RADIAL", 5),
    4: ("OPENCV", 8),
    5: ("OPENCV_FISHEYE", 8),
    6: ("FULL_OPENCV", 12),
    7: ("FOV", 5),
    8: ("SIMPLE_RADIAL_FISHEYE", 4),
    9: ("RADIAL_FISHEYE", 5),
    10: ("THIN_PRISM_FISHEYE", 12),
    11: ("RAD_TAN_THIN_PRISM_FISHEYE", 16),
}
_COUNTS = dict(MODELS.values())
LARGEST_FILE = 2 * 2**30  # bytes; a large model's images with all their points have some hundred million
_READABLE = "SIMPLE_PINHOLE, PINHOLE, SIMPLE_RADIAL, RADIAL, OPENCV, FULL_OPENCV"


def intrinsics_of(camera: ColmapCamera, where: str) -> tuple[np.ndarray, np.ndarray]:
    """Read the matrix K and the five distortion coefficients k1 k2 p1 p2 k3 of one COLMAP camera."""
    if camera.model not in _READABLE.split(", "):
        raise InputError(
            f"{where} uses the camera model {camera.model}, which is not supported; expected one of {_READABLE}: "
            "calibrate again with OPENCV, or undistort the videos first"
        )
    p = camera.parameters
    shared_focal = camera.model in ("SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL")
    if shared_focal:
        fx, fy, cx, cy, rest = p[0], p[0], p[1], p[2], p[3:]
    else:
        fx, fy, cx, cy, rest = p[0], p[1], p[2], p[3], p[4:]
    if len(rest) == 8 and any(rest[5:]):
        raise InputError(
            f"{where} is FULL_OPENCV with k4 k5 k6 = {rest[5:]}; only k1 k2 p1 p2 k3 are supported, so these must "
            "be 0: calibrate again with OPENCV"
        )
    distortion = np.zeros(5)
    distortion[: min(len(rest), 5)] = rest[:5]
    return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]), distortion


def colmap_files(folder: Path) -> tuple[Path, Path] | None:
    """Find the cameras and images file of a model folder, or None; the binary form goes first, as in COLMAP."""
    for suffix in ("bin", "txt"):
        pair = folder / f"cameras.{suffix}", folder / f"images.{suffix}"
        if all(file.is_file() for file in pair):
            return pair
    return None


def read_colmap(cameras_file: Path, images_file: Path) -> ColmapModel:
    """Read one model, text or binary by suffix. Raises `InputError` for anything truncated, malformed or absurd."""
    labels = tuple(f"{file.parent.name}/{file.name}" for file in (cameras_file, images_file))
    try:
        for file, label in zip((cameras_file, images_file), labels, strict=True):
            if file.stat().st_size > LARGEST_FILE:
                raise InputError(
                    f"{label} has {file.stat().st_size / 2**20:.0f} MB; expected a COLMAP model of at most "
                    f"{LARGEST_FILE // 2**20} MB: export it without points"
                )
        if cameras_file.suffix == ".bin":
            cameras = _binary_cameras(BoundedBytes(cameras_file.read_bytes(), labels[0]))
            images = _binary_images(BoundedBytes(images_file.read_bytes(), labels[1]))
        else:
            cameras = _text_cameras(cameras_file.read_text(encoding="utf-8-sig"), labels[0])
            images = _text_images(images_file.read_text(encoding="utf-8-sig"), labels[1])
    except UnicodeDecodeError as error:
        raise InputError(
            f"{labels[0]} or {labels[1]} is not UTF-8 text: {error.reason} at byte {error.start}"
        ) from error
    except OSError as error:
        raise InputError(f"{labels[0]} or {labels[1]} cannot be read: {error.strerror}") from error
    return ColmapModel(cameras, images, *labels)


def _numbers(words: list[str], where: str) -> tuple[float, ...]:
    try:
        return tuple(float(word) for word in words)
    except ValueError:
        raise InputError(f"{where}: expected numbers, found {' '.join(words)[:80]!r}") from None


def _whole(word: str, where: str) -> int:
    try:
        return int(word)
    except ValueError:
        raise InputError(f"{where}: expected a whole number, found {word[:80]!r}") from None


def _text_cameras(text: str, label: str) -> dict[int, ColmapCamera]:
    cameras = {}
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        where = f"{label} line {number}"
        if len(words) < 5:
            raise InputError(f"{where}: expected CAMERA_ID MODEL WIDTH HEIGHT PARAMS, found {line[:80]!r}")
        size = _whole(words[2], where), _whole(words[3], where)
        camera = ColmapCamera(words[1], size, _numbers(words[4:], where))
        if camera.model in _COUNTS and len(camera.parameters) != _COUNTS[camera.model]:
            raise InputError(
                f"{where}: {camera.model} takes {_COUNTS[camera.model]} parameters, found {len(camera.parameters)}"
            )
        cameras[_whole(words[0], where)] = camera
    return cameras


def _is_points(words: list[str]) -> bool:
    """Whether a line lists observations (x y point_id, repeated; possibly none) rather than the next image."""
    try:
        return len(words) % 3 == 0 and all(float(word) is not None for word in words)
    except ValueError:
        return False


def _text_images(text: str, label: str) -> list[ColmapImage]:
    """Two lines per image. The second may be empty, and a writer that dropped the empty ones is understood too."""
    images = []
    after_header = False
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.split()
        if words and words[0].startswith("#"):
            continue
        if not words or (after_header and _is_points(words)):
            after_header = False
            continue
        where = f"{label} line {number}"
        if len(words) < 10:
            raise InputError(
                f"{where}: expected IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME, found {len(words)} words: "
                f"{line[:80]!r}"
            )
        name = line.split(maxsplit=9)[9].strip()
        pose = _numbers(words[1:8], where)
        images.append(ColmapImage(name, pose[:4], pose[4:], _whole(words[8], where)))
        after_header = True
    return images


class BoundedBytes:
    """A cursor over a binary file that never reads past its end and never trusts a count."""

    def __init__(self, data: bytes, label: str):
        self.data, self.label, self.at = data, label, 0

    def take(self, layout: str) -> tuple:
        size = struct.calcsize(layout)
        self.skip(size)
        return struct.unpack_from(layout, self.data, self.at - size)

    def skip(self, size: int) -> None:
        if self.at + size > len(self.data):
            raise InputError(
                f"{self.label} is truncated: {size} bytes expected at byte {self.at}, but the file ends at byte "
                f"{len(self.data)}; copy or export the model again"
            )
        self.at += size

    def count(self, what: str, smallest: int) -> int:
        """Read a 64-bit count and hold it against the bytes that are left, before anything is reserved for it."""
        (count,) = self.take("<Q")
        if count * smallest > len(self.data) - self.at:
            raise InputError(
                f"{self.label} is damaged or truncated: its header announces {count} {what}, for which at least "
                f"{count * smallest} bytes would follow, but only {len(self.data) - self.at} do"
            )
        return count

    def name(self) -> str:
        end = self.data.find(b"\0", self.at)
        if end < 0:
            raise InputError(f"{self.label} is truncated: the image name at byte {self.at} has no end")
        raw, self.at = self.data[self.at : end], end + 1
        return raw.decode("utf-8", errors="replace")


def _binary_cameras(data: BoundedBytes) -> dict[int, ColmapCamera]:
    cameras = {}
    for _ in range(data.count("cameras", 48)):
        camera_id, model_id, width, height = data.take("<IiQQ")
        if model_id not in MODELS:
            raise InputError(
                f"{data.label}: camera {camera_id} has the unknown model number {model_id}; expected 0 to {max(MODELS)}"
            )
        model, count = MODELS[model_id]
        cameras[camera_id] = ColmapCamera(model, (width, height), data.take(f"<{count}d"))
    return cameras


def _binary_images(data: BoundedBytes) -> list[ColmapImage]:
    images = []
    for _ in range(data.count("images", 73)):
        _, *pose, camera_id = data.take("<I7dI")
        name = data.name()
        data.skip(24 * data.count(f"points in image {name}", 24))
        images.append(ColmapImage(name, tuple(pose[:4]), tuple(pose[4:]), camera_id))
    return images
