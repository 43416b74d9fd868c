"""Calibrations of static cameras in OpenCV's FileStorage form: YAML, XML or JSON.

OpenCV fixes the form of a matrix, not the names around it. Understood are those of its own calibration samples
(`camera_matrix`, `distortion_coefficients`, `image_width`, `image_height`; `R`, `T`), of its functions (`rvec`, `tvec`,
`cameraMatrix`, `distCoeffs`) and of OpenPose (`Intrinsics`, `Distortion`, and `CameraMatrix`, which is the 3 x 4 pose).
A file holds one section per camera, called by its `name` or its key, or it is named after its only camera and a folder
holds them all. Rotation and translation go from the world to the camera; lengths are in the capture's units.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ._file_storage import read_storage
from ._static_camera import (
    StaticCamera,
    WrittenCamera,
    check_names,
    five_coefficients,
    numbers,
    one_rotation,
    pinhole,
    pose,
    read_text,
    whole_size,
)

SUFFIXES = (".yml", ".yaml", ".xml", ".json")
_MATRIX = ("camera_matrix", "cameraMatrix", "K", "Intrinsics", "intrinsics", "intrinsic_matrix")
_DISTORTION = ("distortion_coefficients", "distCoeffs", "dist_coeffs", "D", "Distortion", "distortion", "dist")
_ROTATION = ("R", "rvec", "rotation", "rotation_matrix")
_TRANSLATION = ("T", "t", "tvec", "translation")
_POSE = "CameraMatrix"
_COUNTS = tuple(shape for count in (4, 5, 8, 12, 14) for shape in ((count,), (1, count), (count, 1)))
ROTATION_SHAPES = ((3,), (3, 1), (1, 3), (3, 3), (9,))
TRANSLATION_SHAPES = ((3,), (3, 1), (1, 3))


def _size(section: Mapping[str, Any], where: str) -> tuple[int, int] | None:
    if "image_width" in section or "image_height" in section:
        sides = [numbers(section, key, where, ((),)) for key in ("image_width", "image_height")]
        return whole_size(np.array(sides), where, "image_width, image_height")
    for key in ("image_size", "imageSize", "size"):
        if key in section:
            return whole_size(numbers(section, key, where, ((2,), (1, 2), (2, 1))), where, key)
    return None


def _pose(section: Mapping[str, Any], where: str) -> np.ndarray:
    if _POSE in section and np.shape(section[_POSE]) == (3, 4):
        matrix = numbers(section, _POSE, where, ((3, 4),))
        return pose(matrix[:, :3], matrix[:, 3])
    keys = [key for key in _ROTATION if key in section] or [_ROTATION[0]]
    rotation = one_rotation({key: numbers(section, key, where, ROTATION_SHAPES) for key in keys}, where)
    return pose(rotation, numbers(section, _TRANSLATION, where, TRANSLATION_SHAPES))


def _camera(section: Mapping[str, Any], where: str) -> StaticCamera:
    key = next((key for key in _MATRIX if key in section), _MATRIX[0])
    distortion = np.zeros(5)
    if any(name in section for name in _DISTORTION):
        distortion = numbers(section, _DISTORTION, where, _COUNTS)
    return StaticCamera(
        _size(section, where),
        pinhole(numbers(section, key, where, ((3, 3),)), where, key),
        five_coefficients(distortion, where, "distortion"),
        _pose(section, where),
    )


def _sections(document: dict[str, Any], stem: str) -> list[tuple[str, dict[str, Any]]]:
    """Names and sections of the cameras of a file; a file that is one camera itself is called `stem`."""
    if any(key in document for key in _MATRIX):
        return [(str(document.get("name", stem)), document)]
    sections = [(key, value) for key, value in document.items() if isinstance(value, dict)]
    return [(str(value.get("name", key)), value) for key, value in sections if any(name in value for name in _MATRIX)]


def read_opencv(document: dict[str, Any], names: tuple[str, ...], label: str) -> list[StaticCamera]:
    """Read the cameras called `names`, in that order, from one FileStorage."""
    sections = _sections(document, Path(label).stem)
    check_names(names, [name for name, _ in sections], label)
    by_name = dict(sections)
    return [_camera(by_name[name], f"{label} camera {name}") for name in names]


def opencv_files(folder: Path, names: tuple[str, ...]) -> dict[str, Path] | None:
    """Find a file `<camera>.yml`, `.yaml`, `.xml` or `.json` for each camera, or None if there is none at all."""
    found = {
        name: folder / f"{name}{suffix}"
        for name in names
        for suffix in SUFFIXES[::-1]
        if (folder / f"{name}{suffix}").is_file()
    }
    if not found:
        return None
    check_names(names, found, f"{folder.name}/")
    return found


def read_opencv_files(files: Mapping[str, Path], names: tuple[str, ...]) -> list[StaticCamera]:
    """Read the cameras called `names` from a file each."""
    cameras = []
    for name in names:
        label = f"{files[name].parent.name}/{files[name].name}"
        cameras += read_opencv(read_storage(read_text(files[name], label), label), (name,), label)
    return cameras


def opencv_text(cameras: list[WrittenCamera], suffix: str) -> str:
    """Write one section per camera, as YAML, XML or JSON by `suffix`.

    It has `name`, `camera_matrix`, `distortion_coefficients`, `image_width`, `image_height`, `R`, and `T` in metres.
    """
    import cv2

    storage = cv2.FileStorage(suffix, cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    for index, camera in enumerate(cameras):
        storage.startWriteStruct(f"camera_{index:02d}", cv2.FILE_NODE_MAP)
        storage.write("name", camera.name)
        storage.write("image_width", camera.size[0])
        storage.write("image_height", camera.size[1])
        storage.write("camera_matrix", camera.intrinsics)
        storage.write("distortion_coefficients", camera.distortion[None])
        storage.write("R", camera.rotation)
        storage.write("T", camera.translation[:, None])
        storage.endWriteStruct()
    return storage.releaseAndGetString()
