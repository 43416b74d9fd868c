"""What a keypoint model has to be able to do, whichever networks and runner it has inside."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from jaxtyping import Float32, Float64, UInt8

from ._region import Region

Network = Callable[[Float32[np.ndarray, "1 height width 3"]], list[np.ndarray]]
"""One picture in, the network's outputs in its own order."""


@dataclass(frozen=True)
class Sighting:
    """A person seen in a region of a picture.

    points: x, y (pixels of the picture) and confidence, in the order of the model's layout.
    presence: how certain it is that there is a person, 0 to 1.
    region: where this person fills the square best.
    """

    points: Float64[np.ndarray, "point 3"]
    presence: float
    region: Region


class PersonModel(Protocol):
    """Finds people in a picture, and the keypoints of the one in a region."""

    def find(self, picture: UInt8[np.ndarray, "height width 3"]) -> list[Region]:
        """Everybody in an RGB picture, the most certain first."""
        ...

    def look(self, picture: UInt8[np.ndarray, "height width 3"], region: Region) -> Sighting:
        """The person in a region of an RGB picture."""
        ...
