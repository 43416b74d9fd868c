"""What a keypoint model has to be able to do, whichever networks and runner it has inside."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from jaxtyping import Bool, Float32, Float64, UInt8

from ._region import Region

Network = Callable[[Float32[np.ndarray, "picture height width 3"]], list[np.ndarray]]
"""Pictures in, the network's outputs in its own order, each with one entry per picture."""


@dataclass(frozen=True)
class Silhouette:
    """Which pixels of a square show the person, as a network sees it.

    Attributes:
        region: the square.
        evidence: log of the odds that a pixel shows the person.
    """

    region: Region
    evidence: Float32[np.ndarray, "size size"]

    def in_picture(self, shape: tuple[int, int]) -> Bool[np.ndarray, "height width"]:
        """Draw the mask of the person in a picture of `shape` (height, width)."""
        return self.region.paste(self.evidence, shape, outside=-1.0) > 0


@dataclass(frozen=True)
class Sighting:
    """A person seen in a region of a picture.

    Attributes:
        points: x, y (pixels of the picture) and confidence, in the order of the model's layout.
        presence: how certain it is that there is a person, 0 to 1.
        region: where this person fills the square best.
        doubt: how far the model's own answers to the same picture lie apart, as a share of the region's side; 0 if it
            gives only one.
        silhouette: of the person; None of a model that knows none.
    """

    points: Float64[np.ndarray, "point 3"]
    presence: float
    region: Region
    doubt: float = 0.0
    silhouette: Silhouette | None = None


class PersonModel(Protocol):
    """Finds people in a picture, and the keypoints of the one in a region."""

    def find(
        self, picture: UInt8[np.ndarray, "height width 3"], part: Region | None = None, *, thorough: bool = True
    ) -> list[Region]:
        """Find everybody in a part of an RGB picture or in all of it, the most certain first.

        Small people too where `thorough`.
        """
        ...

    def look(self, picture: UInt8[np.ndarray, "height width 3"], region: Region) -> Sighting:
        """Look at the person in a region of an RGB picture."""
        ...
