"""Joints whose places are known when a body is laid into a surface: exactly, or about, or along a line of sight."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

_EXACT = 0.01  # metres, standard deviation of a joint that somebody has placed
_REACH = 2.0  # of the scale of the fit: a doubted joint that is farther off counts for less


class Pin(NamedTuple):
    """Where a joint is. `information` (3, 3) is the inverse covariance of `place`, in the same units; of a `doubted`
    pin, which some detector has placed, large distances count for less and less."""

    place: Float[np.ndarray, "3"]
    information: Float[np.ndarray, "3 3"]
    doubted: bool = False

    def seen(self, matrix: Float[np.ndarray, "4 4"]) -> "Pin":
        """The pin after a similarity; one that is not doubted has its centimetre there."""
        linear = matrix[:3, :3]
        place = linear @ self.place + matrix[:3, 3]
        if not self.doubted:
            return exact(place)
        back = np.linalg.inv(linear)
        return Pin(place, back.T @ self.information @ back, doubted=True)


class Missed(NamedTuple):
    """How far a body's joints are from their pins: half the squares, and a quadratic in a step of the body."""

    energy: float
    hessian: Float[np.ndarray, "parameter parameter"]
    gradient: Float[np.ndarray, " parameter"]


def exact(place: Float[np.ndarray, "3"]) -> Pin:
    """A joint placed by hand."""
    return Pin(place, np.eye(3) / _EXACT**2)


def missed(
    pins: Mapping[str, Pin],
    places: Mapping[str, Float[np.ndarray, "3"]],
    slopes: Mapping[str, Float[np.ndarray, "3 parameter"]],
    scale: float,
    size: int,
) -> Missed:
    """Of joints at `places` with derivatives `slopes` by a step of `size` numbers. `scale` is the distance in metres
    beyond which a pair of points is left out in the same step (Geman and McClure)."""
    energy, hessian, gradient = 0.0, np.zeros((size, size)), np.zeros(size)
    for name, pin in pins.items():
        off, slope = places[name] - pin.place, slopes[name]
        square = float(off @ pin.information @ off)
        falling = 1.0 / (1.0 + float(off @ off) / (_REACH * scale) ** 2) if pin.doubted else 1.0
        energy += 0.5 * square * falling
        pulled = falling**2 * slope.T @ pin.information
        hessian += pulled @ slope
        gradient += pulled @ off
    return Missed(energy, hessian, gradient)
