"""Calibrations of static cameras in the TOML form of aniposelib and Pose2Sim."""

import tomllib
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxmocap._results import InputError


class StaticCamera(NamedTuple):
    size: tuple[int, int] | None
    intrinsics: np.ndarray
    distortion: np.ndarray
    cam_from_world: np.ndarray


def _array(section: dict[str, Any], key: str, where: str, shapes: tuple[tuple[int, ...], ...]) -> np.ndarray:
    expected = " or ".join("x".join(map(str, shape)) for shape in shapes)
    if key not in section:
        raise InputError(f"{where} has no {key}; expected {expected} numbers")
    try:
        value = np.asarray(section[key], dtype=float)
    except (TypeError, ValueError):
        raise InputError(f"{where}: {key} is not an array of numbers; expected {expected}") from None
    if value.shape not in shapes:
        found = "x".join(map(str, value.shape)) or "a single value"
        raise InputError(f"{where}: {key} has shape {found}; expected {expected}")
    return value


def _rotation(section: dict[str, Any], where: str) -> np.ndarray:
    from scipy.spatial.transform import Rotation

    value = _array(section, "rotation", where, ((3,), (9,), (3, 3), (3, 1)))
    if value.size == 9:
        return value.reshape(3, 3)
    if not np.isfinite(value).all():
        raise InputError(f"{where}: rotation is not finite: {value.ravel().tolist()}")
    return Rotation.from_rotvec(value.ravel()).as_matrix()


def _distortion(section: dict[str, Any], where: str) -> np.ndarray:
    if "distortions" not in section:
        return np.zeros(5)
    value = _array(section, "distortions", where, ((1,), (2,), (4,), (5,), (8,), (12,), (14,)))
    if value[5:].any():
        raise InputError(f"{where}: distortions beyond k1 k2 p1 p2 k3 must be 0, found {value[5:].tolist()}")
    result = np.zeros(5)
    result[: min(value.size, 5)] = value[:5]
    return result


def _size(section: dict[str, Any], where: str) -> tuple[int, int] | None:
    if "size" not in section:
        return None
    value = _array(section, "size", where, ((2,),))
    if not np.isfinite(value).all() or (value != np.round(value)).any() or (value < 1).any():
        raise InputError(f"{where}: size must be two whole numbers, width and height, found {value.tolist()}")
    return int(value[0]), int(value[1])


def _camera(section: dict[str, Any], where: str) -> StaticCamera:
    if section.get("fisheye"):
        raise InputError(f"{where} is a fisheye calibration, which is not supported: undistort the video first")
    intrinsics = _array(section, "matrix", where, ((3, 3),))
    if not np.allclose(intrinsics[2], [0, 0, 1]) or intrinsics[1, 0] != 0 or intrinsics[0, 1] != 0:
        raise InputError(
            f"{where}: matrix must be [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], found {intrinsics.tolist()}; "
            "is it transposed?"
        )
    intrinsics = intrinsics.copy()
    intrinsics[:2, 2] += 0.5  # OpenCV puts (0, 0) at the centre of the first pixel, we at its corner
    pose = np.eye(4)
    pose[:3, :3] = _rotation(section, where)
    pose[:3, 3] = _array(section, "translation", where, ((3,), (3, 1))).ravel()
    return StaticCamera(_size(section, where), intrinsics, _distortion(section, where), pose)


def read_calibration_toml(path: Path, names: tuple[str, ...]) -> list[StaticCamera]:
    """The cameras called `names`, in that order: a section's `name`, else the section's own title.

    Sections of other cameras are ignored, since a rig's calibration may cover more cameras than a capture uses.
    The principal point is moved by half a pixel to our convention.
    """
    try:
        document = tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except (UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise InputError(
            f"{path.name} is neither a COLMAP model nor a TOML calibration: {error}; expected a folder with "
            "cameras.txt and images.txt (or .bin), or an aniposelib / Pose2Sim calibration"
        ) from error
    sections = {title: value for title, value in document.items() if isinstance(value, dict) and "matrix" in value}
    by_name = sections | {str(value["name"]): value for value in sections.values() if "name" in value}
    missing = [name for name in names if name not in by_name]
    if missing:
        listed = ", ".join(str(value.get("name", title)) for title, value in sections.items()) or "none"
        raise InputError(
            f"{path.name} has no camera called {', '.join(missing)}; its cameras are: {listed}. Give the cameras in "
            "capture.toml the calibration's names"
        )
    return [_camera(by_name[name], f"{path.name} camera {name}") for name in names]
