"""Axes of files that do not name theirs."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from jaxmocap._results import InputError
from jaxmocap.character import rest_frame

AXES = {
    f"{sign}{'xyz'[axis]}": (-1.0 if sign == "-" else 1.0) * np.eye(3)[axis] for sign in ("", "-") for axis in range(3)
}
_TILT = 8.0  # degrees by which bones may miss an axis of the file that they mean


def upright(places: Mapping[str, np.ndarray]) -> Float[np.ndarray, "3 3"]:
    """Rotation from the file's axes to the rest frame's, from joints: up is the axis of the file that is near, if any,
    and so is left, if up is; a scan may face in any direction, or hang in space."""
    left, up, _ = rest_frame(dict(places), near=0.0)
    vertical = _snapped(up)
    left = left - (left @ vertical) * vertical
    left /= np.linalg.norm(left)
    if vertical is not up:
        left = _snapped(left)
    return np.stack([left, vertical, np.cross(left, vertical)])


def _snapped(direction: np.ndarray) -> np.ndarray:
    nearest = max(AXES.values(), key=lambda axis: axis @ direction)
    return nearest if nearest @ direction > np.cos(np.radians(_TILT)) else direction


def named_axis(option: str, axis: str | None) -> Float[np.ndarray, "3"] | None:
    """The direction that an option names, such as "-y"; None for None."""
    if axis is None:
        return None
    if axis not in AXES:
        raise InputError(f"{option} is {axis!r}; one of the file's axes was expected: {', '.join(AXES)}.")
    return AXES[axis]


def axis_name(direction: np.ndarray) -> str:
    """ "z" or "-y" for a direction along an axis of the file, else its three numbers."""
    unit = direction / np.linalg.norm(direction)
    for name, axis in AXES.items():
        if unit @ axis > 1 - 1e-6:
            return name
    return " ".join(f"{value:.2f}" for value in unit)
