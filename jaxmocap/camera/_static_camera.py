"""What the calibration formats of static cameras share: one camera's record, and numbers read with sentences."""

import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from jaxmocap._results import InputError

_LARGEST_FILE = 4 * 2**20  # bytes; a calibration of a hundred cameras has a hundred thousand
_SAME_ROTATION = 1e-3
OPENCV_CENTRE = 0.5  # OpenCV puts (0, 0) at the centre of the first pixel, we at its corner


class StaticCamera(NamedTuple):
    """One camera as a calibration file has it, in our convention of pixels.

    Attributes:
        size: (width, height), pixels; None: the file does not say.
        intrinsics: K, the centre of the first pixel at (0.5, 0.5).
        distortion: k1 k2 p1 p2 k3.
        cam_from_world: the pose, in the file's lengths.
    """

    size: tuple[int, int] | None
    intrinsics: np.ndarray
    distortion: np.ndarray
    cam_from_world: np.ndarray


class WrittenCamera(NamedTuple):
    """One camera as a calibration in OpenCV's convention holds it.

    Attributes:
        name: the capture's.
        size: (width, height), pixels.
        intrinsics: K, the centre of the first pixel at (0, 0).
        distortion: k1 k2 p1 p2 k3.
        rotation: from the world to the camera.
        translation: the same, metres.
    """

    name: str
    size: tuple[int, int]
    intrinsics: np.ndarray
    distortion: np.ndarray
    rotation: np.ndarray
    translation: np.ndarray


def read_text(path: Path, label: str) -> str:
    """Read the text of a calibration file.

    Raises `InputError` for one that is absurdly large, a pickle or not UTF-8.
    """
    try:
        size = path.stat().st_size
        if size > _LARGEST_FILE:
            raise InputError(
                f"{label} has {size / 2**20:.0f} MB; expected a calibration file of at most {_LARGEST_FILE // 2**20} MB"
            )
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"{label} cannot be read: {error.strerror}") from error
    if path.suffix.lower() in (".pickle", ".pkl") or re.match(rb"\x80[\x02-\x05]", data):
        raise InputError(
            f"{label} is a pickle, which may run programs and is never loaded; expected a calibration as text: convert "
            "it with the program that wrote it, for instance to Pose2Sim's TOML"
        )
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(
            f"{label} is neither a COLMAP model nor a calibration that is known: it is not UTF-8 text; expected a "
            "calibration of aniposelib, Pose2Sim, FreeMoCap, EasyMocap, Qualisys or OpenCV"
        ) from error


def numbers(
    section: Mapping[str, Any], keys: str | tuple[str, ...], where: str, shapes: tuple[tuple[int, ...], ...]
) -> np.ndarray:
    """Read the array under the first of these keys that is there, with one of these shapes."""
    keys = (keys,) if isinstance(keys, str) else keys
    expected = " or ".join("x".join(map(str, shape)) for shape in shapes)
    key = next((key for key in keys if key in section), None)
    if key is None:
        raise InputError(f"{where} has no {keys[0]}; expected {expected} numbers")
    try:
        value = np.asarray(section[key], dtype=float)
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"{where}: {key} is not an array of numbers; expected {expected}") from None
    if value.shape not in shapes:
        found = "x".join(map(str, value.shape)) or "a single value"
        raise InputError(f"{where}: {key} has shape {found}; expected {expected}")
    return value


def rotation_matrix(value: np.ndarray, where: str, key: str = "rotation") -> Float[np.ndarray, "3 3"]:
    """Read a rotation given as a vector (Rodrigues) or as a matrix, nested or flat, row by row."""
    from scipy.spatial.transform import Rotation

    if not np.isfinite(value).all():
        raise InputError(f"{where}: {key} is not finite: {value.ravel().tolist()}")
    return value.reshape(3, 3) if value.size == 9 else Rotation.from_rotvec(value.ravel()).as_matrix()


def one_rotation(found: Mapping[str, np.ndarray], where: str) -> Float[np.ndarray, "3 3"]:
    """Read the rotation that a file gives under several keys, as vectors or matrices, which must agree."""
    rotations = {key: rotation_matrix(value, where, key) for key, value in found.items()}
    first = next(iter(rotations))
    for key, rotation in rotations.items():
        if np.abs(rotation - rotations[first]).max() > _SAME_ROTATION:
            raise InputError(
                f"{where}: {first} and {key} are different rotations (off by "
                f"{np.abs(rotation - rotations[first]).max():.3g}); expected the same one: remove the wrong one"
            )
    return rotations[first]


def five_coefficients(value: np.ndarray, where: str, key: str = "distortions") -> Float[np.ndarray, "5"]:
    """Read k1 k2 p1 p2 k3 of a distortion in OpenCV's order, whose further coefficients must be 0."""
    value = value.ravel()
    if value[5:].any():
        raise InputError(f"{where}: {key} beyond k1 k2 p1 p2 k3 must be 0, found {value[5:].tolist()}")
    return np.concatenate([value[:5], np.zeros(max(0, 5 - value.size))])


def pinhole(matrix: np.ndarray, where: str, key: str = "matrix") -> Float[np.ndarray, "3 3"]:
    """Convert K from OpenCV's convention to ours, checking its form."""
    if not np.allclose(matrix[2], [0, 0, 1]) or matrix[1, 0] != 0 or matrix[0, 1] != 0:
        raise InputError(
            f"{where}: {key} must be [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], found {matrix.tolist()}; is it transposed?"
        )
    matrix = matrix.copy()
    matrix[:2, 2] += OPENCV_CENTRE
    return matrix


def whole_size(value: np.ndarray, where: str, key: str = "size") -> tuple[int, int]:
    """Read (width, height) in whole pixels."""
    if not np.isfinite(value).all() or (value != np.round(value)).any() or (value < 1).any():
        raise InputError(f"{where}: {key} must be two whole numbers, width and height, found {value.ravel().tolist()}")
    return int(value.flat[0]), int(value.flat[1])


def pose(rotation: Float[np.ndarray, "3 3"], translation: np.ndarray) -> Float[np.ndarray, "4 4"]:
    """Build a 4 x 4 transform."""
    result = np.eye(4)
    result[:3, :3], result[:3, 3] = rotation, translation.ravel()
    return result


def check_names(wanted: Iterable[str], known: Iterable[str], label: str) -> None:
    """Raise `InputError` unless every camera asked for is among those of the file, once."""
    known = list(known)
    missing = [name for name in wanted if name not in known]
    if missing:
        raise InputError(
            f"{label} has no camera called {', '.join(missing)}; its cameras are: {', '.join(known) or 'none'}. Give "
            "the cameras in capture.toml the calibration's names"
        )
    twice = [name for name in wanted if known.count(name) > 1]
    if twice:
        raise InputError(f"{label} has several cameras called {twice[0]}; expected one: rename the others")
