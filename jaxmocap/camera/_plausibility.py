"""Sentences about cameras that cannot be true: mirrored, without focal length, of another size, in other units."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

_ROTATION_TOLERANCE = 1e-3
_LARGEST = 1e9  # pixels and coefficients
_FARTHEST_APART = 100.0  # metres between two cameras that film one person
_FARTHEST_FROM_ORIGIN = 1000.0
_NEAREST_APART = 0.005
_EXPORT_AGAIN = "files of this form are in millimetres; calibrate or export it in them again"
_UNITS = {1.0: "metres", 0.01: "centimetres", 0.001: "millimetres"}


def intrinsics_problems(
    size: tuple[int, int],
    video: tuple[int, int] | None,
    k: Float[np.ndarray, "3 3"],
    distortion: Float[np.ndarray, " 5"],
    where: str,
) -> list[str]:
    """List what is wrong with one camera's size, K and distortion; `video` is the size of its video where known."""
    problems = []
    if not ((np.abs(k) < _LARGEST).all() and (np.abs(distortion) < _LARGEST).all()):
        problems.append(
            f"{where}: focal lengths, principal point and distortion must be finite numbers of a sensible size"
        )
    elif k[0, 0] == 0 or k[1, 1] == 0:
        problems.append(f"{where}: the focal length is 0; expected pixels, about the width of the image")
    elif k[0, 0] < 0 or k[1, 1] < 0:
        problems.append(
            f"{where}: the focal lengths {k[0, 0]:g} and {k[1, 1]:g} mirror the image; both must be positive, with x "
            "to the right, y down and z forward (OpenGL and Blender look along -z: turn those by 180 degrees about x)"
        )
    if video is not None and size != video:
        swapped = "; the sides are swapped: was the video turned after the calibration?" if size == video[::-1] else ""
        problems.append(
            f"{where} is calibrated for {size[0]}x{size[1]} pixels, but its video has {video[0]}x{video[1]}{swapped}"
        )
    return problems


def rotation_problem(rotation: Float[np.ndarray, "3 3"], where: str) -> str | None:
    """Say why a matrix is no rotation, or None."""
    if not np.isfinite(rotation).all():
        return f"{where}: the rotation is not finite"
    if np.linalg.det(rotation) < 0:
        return (
            f"{where}: the rotation has determinant {np.linalg.det(rotation):.3g}, a mirrored camera; expected +1: one "
            "axis is flipped between the calibration's world and a right-handed one"
        )
    error = np.abs(rotation @ rotation.T - np.eye(3)).max()
    if error > _ROTATION_TOLERANCE:
        return f"{where}: the rotation matrix is not orthonormal (off by {error:.3g})"
    return None


def scale_problem(
    poses: Float[np.ndarray, "camera frame 4 4"],
    names: Sequence[str],
    label: str,
    metres_per_unit: float,
    fixed: bool = False,
) -> list[str]:
    """Say whether the cameras' distances suggest other units.

    Cameras that film one person stand centimetres to tens of metres apart.

    `fixed`: the form of the file settles its units, so that capture.toml cannot.
    """
    centres = -np.einsum("ctji,ctj->cti", poses[..., :3, :3], poses[..., :3, 3])
    units = _UNITS.get(metres_per_unit, "its units")
    for first in range(len(names)):
        for second in range(first + 1, len(names)):
            apart = float(np.median(np.linalg.norm(centres[first] - centres[second], axis=-1)))
            found = f"{label}: {names[first]} and {names[second]} are {apart:.3g} m apart when read in {units}"
            if apart > _FARTHEST_APART:
                guess = "millimetres" if apart > 500 else "centimetres"
                cure = f'set units = "{guess}" in capture.toml'
                return [f"{found}, which looks like {guess}: {_EXPORT_AGAIN if fixed else cure}"]
            if apart < _NEAREST_APART and metres_per_unit < 1:
                cure = 'set units = "metres" in capture.toml'
                return [f"{found}, which looks like metres: {_EXPORT_AGAIN if fixed else cure}"]
    farthest = np.linalg.norm(centres, axis=-1).max(axis=1)
    if farthest.max() > _FARTHEST_FROM_ORIGIN:
        return [
            f"{label}: {names[int(farthest.argmax())]} is {farthest.max():.0f} m from the world's origin when read in "
            f"{units}, which looks like "
            + (
                f"other units or map coordinates: {_EXPORT_AGAIN}"
                if fixed
                else "millimetres or map coordinates: set units in capture.toml, or move the origin"
            )
        ]
    return []
