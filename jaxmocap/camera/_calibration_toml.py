"""Calibrations of static cameras in the TOML form of aniposelib, Pose2Sim and FreeMoCap.

The form is that of aniposelib's `CameraGroup.dump`: a section per camera with `name`, `size` (width, height), `matrix`
and `distortions` in OpenCV's convention, and `rotation` (Rodrigues) and `translation` from the world to the camera.
Pose2Sim writes the same. FreeMoCap's `freemocap_anipose.py` adds `world_orientation` and `world_position`, the camera
in the world; lengths are **millimetres**, in which its user gives `charuco_square_size`. The others fix no units.
"""

import json
import tomllib
from collections.abc import Iterator
from typing import Any

import numpy as np

from jaxmocap._results import InputError

from ._static_camera import (
    StaticCamera,
    WrittenCamera,
    check_names,
    five_coefficients,
    numbers,
    pinhole,
    pose,
    rotation_matrix,
    whole_size,
)

_MILLIMETRE = 0.001


def _camera(section: dict[str, Any], where: str) -> StaticCamera:
    if section.get("fisheye"):
        raise InputError(f"{where} is a fisheye calibration, which is not supported: undistort the video first")
    counts = ((1,), (2,), (4,), (5,), (8,), (12,), (14,))
    distortion = numbers(section, "distortions", where, counts) if "distortions" in section else np.zeros(5)
    return StaticCamera(
        whole_size(numbers(section, "size", where, ((2,),)), where) if "size" in section else None,
        pinhole(numbers(section, "matrix", where, ((3, 3),)), where),
        five_coefficients(distortion, where),
        pose(
            rotation_matrix(numbers(section, "rotation", where, ((3,), (9,), (3, 3), (3, 1))), where),
            numbers(section, "translation", where, ((3,), (3, 1))),
        ),
    )


def _freemocap_unit(document: dict[str, Any], sections: dict[str, dict], label: str) -> float | None:
    """Metres per unit of a calibration by FreeMoCap; None if it is none, or if its squares were measured in metres."""
    metadata = document.get("metadata")
    square = metadata.get("charuco_square_size") if isinstance(metadata, dict) else None
    if square is None and not any("world_position" in section for section in sections.values()):
        return None
    if square == 1:
        raise InputError(
            f"{label} has charuco_square_size = 1, FreeMoCap's default, so its lengths count squares of an unknown "
            "size; expected millimetres: calibrate again with the size of the board's squares"
        )
    return None if isinstance(square, float) and square < 1 else _MILLIMETRE


def read_calibration_toml(text: str, names: tuple[str, ...], label: str) -> tuple[list[StaticCamera], float | None]:
    """Read the cameras called `names`, in that order, and metres per unit where the file settles it.

    A name is a section's `name`, else the section's own title.

    Sections of other cameras are ignored, since a rig's calibration may cover more cameras than a capture uses.
    The principal point is moved by half a pixel to our convention.
    """
    try:
        document = tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise InputError(
            f"{label} is neither a COLMAP model nor a TOML calibration: {error}; expected a folder with cameras.txt "
            "and images.txt (or .bin), or a calibration of aniposelib, Pose2Sim, FreeMoCap, EasyMocap, Qualisys or "
            "OpenCV"
        ) from error
    sections = {title: value for title, value in document.items() if isinstance(value, dict) and "matrix" in value}
    named = [str(value.get("name", title)) for title, value in sections.items()]
    titles = [title for title in names if title in sections and title not in named]
    check_names(names, named + titles, label)
    by_name = sections | {str(value["name"]): value for value in sections.values() if "name" in value}
    unit = _freemocap_unit(document, sections, label)
    return [_camera(by_name[name], f"{label} camera {name}") for name in names], unit


def _section(index: int, camera: WrittenCamera, unit: float) -> Iterator[str]:
    from scipy.spatial.transform import Rotation

    coefficients = camera.distortion if camera.distortion[4] else camera.distortion[:4]
    yield f"[cam_{index:02d}]"
    yield f"name = {json.dumps(camera.name, ensure_ascii=False)}"
    yield f"size = {list(camera.size)}"
    yield f"matrix = {camera.intrinsics.tolist()}"
    yield f"distortions = {coefficients.tolist()}"
    yield f"rotation = {Rotation.from_matrix(camera.rotation).as_rotvec().tolist()}"
    yield f"translation = {(camera.translation / unit).tolist()}"


def aniposelib_text(cameras: list[WrittenCamera]) -> str:
    """Write a calibration as aniposelib and Pose2Sim write and read it, in metres."""
    parts = ["\n".join([*_section(index, camera, 1.0), "fisheye = false", ""]) for index, camera in enumerate(cameras)]
    return "\n".join([*parts, "[metadata]", "adjusted = false", "error = 0.0", ""])


def freemocap_text(cameras: list[WrittenCamera]) -> str:
    """Write a calibration as FreeMoCap writes and reads it, in millimetres."""
    parts = []
    for index, camera in enumerate(cameras):
        position = -camera.rotation.T @ camera.translation / _MILLIMETRE
        own = [f"world_orientation = {camera.rotation.T.tolist()}", f"world_position = {position.tolist()}", ""]
        parts.append("\n".join([*_section(index, camera, _MILLIMETRE), *own]))
    return "\n".join([*parts, "[metadata]", ""])
