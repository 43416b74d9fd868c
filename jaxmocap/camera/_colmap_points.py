"""The points of a COLMAP model, in its text or binary form."""

from pathlib import Path

import numpy as np
from jaxtyping import Float

from jaxmocap._results import InputError

from ._colmap import LARGEST_FILE, BoundedBytes


def read_colmap_points(folder: Path) -> tuple[Float[np.ndarray, "point 3"], Float[np.ndarray, " point"]]:
    """Read the points: places in the model's units and mean reprojection errors in pixels.

    Both are empty where the model has no points. Raises `InputError` for a damaged file.
    """
    binary, text = folder / "points3D.bin", folder / "points3D.txt"
    file = binary if binary.is_file() else text
    if not file.is_file():
        return np.zeros((0, 3)), np.zeros(0)
    label = f"{folder.name}/{file.name}"
    try:
        if file.stat().st_size > LARGEST_FILE:
            raise InputError(f"{label} has {file.stat().st_size / 2**20:.0f} MB; export the model with fewer points")
        rows = (
            _binary_points(file.read_bytes(), label)
            if file == binary
            else _text_points(file.read_text(encoding="utf-8-sig"), label)
        )
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{label} cannot be read: {error}") from error
    values = np.array(rows, float).reshape(-1, 4)
    return values[:, :3], values[:, 3]


def _binary_points(data: bytes, label: str) -> list[tuple[float, ...]]:
    cursor, rows = BoundedBytes(data, label), []
    for _ in range(cursor.count("points", 51)):
        _, x, y, z, _, _, _, error = cursor.take("<Q3d3Bd")
        cursor.skip(8 * cursor.count("observations", 8))
        rows.append((x, y, z, error))
    return rows


def _text_points(text: str, label: str) -> list[tuple[float, ...]]:
    rows = []
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        try:
            rows.append((float(words[1]), float(words[2]), float(words[3]), float(words[7])))
        except (IndexError, ValueError):
            raise InputError(
                f"{label} line {number}: expected POINT3D_ID X Y Z R G B ERROR, found {line[:80]!r}"
            ) from None
    return rows
