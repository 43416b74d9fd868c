"""What a source predicts of a view, held against what the view shows, by optical flow."""

from dataclasses import dataclass
from typing import Literal, NamedTuple

import cv2
import numpy as np
from jaxtyping import Array, Bool, Float, Int, UInt8, UInt32

from jaxmocap.observation import flow_agrees, flow_both_ways, sample_picture, squared_length

from ._transfer import transfer
from ._views import View

MARGIN = 3
"""Pixels from the silhouette that flow does not tell of."""

FACING = 0.25
"""Least cosine between a face's normal and the direction to either camera."""

COLOUR = 0.2
"""Largest grey difference of a match that is believed, 0 to 1."""

LONGEST = 25.0
"""Longest flow that is believed, pixels."""


@dataclass(frozen=True)
class FlowSettings:
    """How closely optical flow looks at the surface. Not in the paper.

    Attributes:
        samples: rows per view and source; 800.
        preset: of OpenCV's DIS flow: "ultrafast", "fast" or "medium"; "medium".
    """

    samples: int = 800
    preset: Literal["ultrafast", "fast", "medium"] = "medium"


class Comparison(NamedTuple):
    """A source transferred into a view: where each pixel's surface point lies in the source, whether it is seen there
    too, whether its flow may be believed, the flow in pixels, and how much structure there is."""

    source_pixel: Float[np.ndarray, "height width 2"]
    seen: Bool[np.ndarray, "height width"]
    good: Bool[np.ndarray, "height width"]
    moved: Float[np.ndarray, "height width 2"]
    weight: Float[np.ndarray, "height width"]


def compare(
    faces: Int[Array | np.ndarray, "face 3"],
    near_faces: UInt32[Array | np.ndarray, "face word"],
    view: View,
    source: View,
    settings: FlowSettings,
) -> Comparison:
    """Compute the flow from what a source predicts of a view of the mesh to what is seen.

    `near_faces` is the bit table of Eq. 7, which says what counts as the same surface.
    """
    source_pixel, seen, cosine = transfer(np.asarray(faces), np.asarray(near_faces), view, source)
    target = view.shown
    weight, moved = np.zeros(seen.shape, np.float32), np.zeros((*seen.shape, 2), np.float32)
    good = np.zeros(seen.shape, bool)
    box = _box_of(seen)
    if box is not None:
        transferred = sample_picture(source.image, source_pixel[box][..., 0], source_pixel[box][..., 1])
        seen_here, target_here = seen[box], target[box]
        gain = float(np.clip(target_here[seen_here].mean() / max(transferred[seen_here].mean(), 1.0), 0.5, 2.0))
        predicted = np.where(seen_here, np.clip(transferred * gain, 0, 255), target_here).astype(np.uint8)
        forward, backward = flow_both_ways(predicted, target_here, settings.preset)
        good[box] = usable(seen_here, cosine[box], forward, backward, predicted, target_here)
        weight[box], moved[box] = textured(predicted), forward
    return Comparison(source_pixel, seen, good, moved, weight)


def _box_of(seen: Bool[np.ndarray, "height width"], border: int = 24) -> tuple[slice, slice] | None:
    """Rows and columns around the pixels seen, or None when they are too few to compare."""
    if seen.sum() < 200:
        return None
    rows, columns = np.flatnonzero(seen.any(1)), np.flatnonzero(seen.any(0))
    return (
        slice(max(int(rows[0]) - border, 0), int(rows[-1]) + border + 1),
        slice(max(int(columns[0]) - border, 0), int(columns[-1]) + border + 1),
    )


def usable(
    seen: Bool[np.ndarray, "height width"],
    cosine: Float[np.ndarray, "height width"],
    forward: np.ndarray,
    backward: np.ndarray,
    predicted: np.ndarray,
    target: np.ndarray,
) -> Bool[np.ndarray, "height width"]:
    """Mark the pixels whose flow may be believed."""
    size = 2 * MARGIN + 1
    good = cv2.erode(seen.astype(np.uint8), np.ones((size, size), np.uint8), borderValue=0) > 0
    good &= (cosine > FACING) & flow_agrees(forward, backward)
    good &= squared_length(forward) < LONGEST**2
    height, width = target.shape
    there = np.arange(width) + 0.5 + forward[..., 0], np.arange(height)[:, None] + 0.5 + forward[..., 1]
    found = sample_picture(target, *there)
    return good & (np.abs(found.astype(np.float32) - predicted) < 255 * COLOUR)


def textured(picture: UInt8[np.ndarray, "height width"]) -> Float[np.ndarray, "height width"]:
    """Measure how far the surroundings of a pixel tell where it is, in [0, 1): 0 where they are flat or an edge."""
    structure = cv2.cornerMinEigenVal(cv2.GaussianBlur(picture, (0, 0), 1.0), 9, ksize=3)
    structure = np.maximum(structure, 0.0)  # rounding makes it negative where the picture is flat
    return structure / (structure + 2e-4)
