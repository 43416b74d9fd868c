"""What the readers of data sets have in common: files of numbers, C3D files, videos, and what is refused."""

from pathlib import Path

import numpy as np
from jaxtyping import Float

from jaxmocap._results import InputError
from jaxmocap.capture import index_video


def need(path: Path, what: str) -> Path:
    """Return the path. Raises `InputError` where it does not exist."""
    if not path.exists():
        raise InputError(f"{path} is not there; {what} was expected.")
    return path


def numbers_in(path: Path, count: int | None = None) -> np.ndarray:
    """Read the numbers of a text file, commas and line ends alike. `InputError` if there are fewer than `count`."""
    need(path, "a text file of numbers")
    try:
        found = np.array(path.read_text().replace(",", " ").split(), float)
    except (ValueError, UnicodeDecodeError):
        raise InputError(f"{path} holds something that is no number.") from None
    if count is not None and len(found) < count:
        raise InputError(f"{path} holds {len(found)} numbers; {count} were expected.")
    return found


def rotation_of(
    rotation: Float[np.ndarray, "3 3"], intrinsics: Float[np.ndarray, "3 3"], path: Path
) -> Float[np.ndarray, "3 3"]:
    """Return the nearest rotation. Raises `InputError` where that and the focal lengths cannot be a camera's."""
    near = np.abs(rotation @ rotation.T - np.eye(3)).max() <= 1e-2 and np.linalg.det(rotation) > 0
    if not near or intrinsics[0, 0] <= 0 or intrinsics[1, 1] <= 0:
        raise InputError(f"{path} holds no camera: its focal lengths or its rotation cannot be true.")
    left, _, right = np.linalg.svd(rotation)
    return left @ right


def read_c3d(path: Path) -> tuple[list[str], Float[np.ndarray, "frame point 3"], float]:
    """Read names and places (metres, NaN where not seen) of a C3D file's points, and its frame rate."""
    import ezc3d

    try:
        file = ezc3d.c3d(str(path))
        points = file["data"]["points"][:3].transpose(2, 1, 0)
        about = file["parameters"]["POINT"]
        unit, rate = str(about["UNITS"]["value"][0]).strip().lower(), float(about["RATE"]["value"][0])
        labels = [str(label) for label in about["LABELS"]["value"]]
    except (OSError, RuntimeError, ValueError, KeyError, IndexError) as error:
        raise InputError(f"{path} is no C3D file that can be read ({error}).") from None
    metres = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}.get(unit)
    if metres is None:
        raise InputError(f"{path} has the unit '{unit}'; mm, cm or m was expected.")
    if not rate > 0:
        raise InputError(f"{path} has the frame rate {rate:g}; a positive one was expected.")
    seen = np.isfinite(points).all(-1) & (points != 0).any(-1)
    return labels, np.where(seen[..., None], metres * points, np.nan), rate


def video_rate(path: Path) -> float:
    """Read a video's frames per second, by the times of its first and last frame."""
    times = index_video(path).seconds
    return float((len(times) - 1) / (times[-1] - times[0])) if len(times) > 1 else 30.0
