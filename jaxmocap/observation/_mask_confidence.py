"""How sure a found mask is."""

from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from jaxmocap.geometry import intersection_over_union

from ._cut_person import CutSettings, cut_person, signed_distance

_MOVED = 0.03
_PLAIN_AGREEMENT, _FULL_AGREEMENT = 0.5, 0.85
_FULL_CONTRAST, _FULL_STABILITY = 1.5, 0.6


class MaskConfidence(NamedTuple):
    """Three signs that a mask is right, and `value`, the weakest of them, in [0, 1].

    `agreement`: intersection over union with the projected body, or with what a detector has seen where that is more.
    `contrast`: how much stronger the image's edges are on the outline than a little beside it, 0 where they are as
    strong, 1 where they are twice as strong. `stability`: cut again with the prior grown and shrunk, which part of the
    change did the mask *not* follow; 1 says that the image alone decides, 0 that it only repeats the prior. Agreement
    alone tells little, for a mask follows its prior: on pure noise it is 0.95.
    """

    agreement: float
    contrast: float
    stability: float

    @property
    def value(self) -> float:
        """Agreement counts fully from 0.85 and not at all below 0.5, contrast from 1.5, stability from 0.6."""
        parts = (
            (self.agreement - _PLAIN_AGREEMENT) / (_FULL_AGREEMENT - _PLAIN_AGREEMENT),
            self.contrast / _FULL_CONTRAST,
            self.stability / _FULL_STABILITY,
        )
        return float(np.clip(min(parts), 0, 1))


def mask_confidence(
    image: UInt8[np.ndarray, "height width 3"],
    mask: Bool[np.ndarray, "height width"],
    silhouette: Bool[np.ndarray, "height width"],
    prior: Bool[np.ndarray, "height width"],
    still: Float[np.ndarray, "height width"] | None = None,
    settings: CutSettings | None = None,
    *,
    seen: Bool[np.ndarray, "height width"] | None = None,
) -> MaskConfidence:
    """Judge a mask that `cut_person` found with this prior and what a detector has `seen`, the body being projected to
    `silhouette`."""
    if not mask.any() or not prior.any():
        return MaskConfidence(0.0, 0.0, 0.0)
    far, size = signed_distance(prior), np.sqrt(prior.sum())
    stability = []
    for moved in (far > -_MOVED * size, far > _MOVED * size):
        alike = intersection_over_union(moved, prior)
        followed = intersection_over_union(mask, cut_person(image, moved, still, settings, seen=seen))
        stability.append((followed - alike) / max(1 - alike, 1e-6))
    agreement = max(float(intersection_over_union(mask, shape)) for shape in (silhouette, seen) if shape is not None)
    return MaskConfidence(agreement, outline_contrast(image, mask), float(min(stability)))


def outline_contrast(image: UInt8[np.ndarray, "height width 3"], mask: Bool[np.ndarray, "height width"]) -> float:
    """Divide the mean edge strength (Sobel in CIELAB) on a mask's outline by that of a band beside it, less 1."""
    far, size = np.abs(signed_distance(mask)), float(np.sqrt(max(mask.sum(), 1)))
    blur = float(np.clip(0.01 * size, 0.7, 1.5))
    smooth = cv2.GaussianBlur(cv2.cvtColor(image, cv2.COLOR_RGB2LAB), (0, 0), blur).astype(np.float32)
    along = [cv2.Sobel(smooth, cv2.CV_32F, *step) for step in ((1, 0), (0, 1))]
    strength = np.sqrt(sum((part**2).sum(2) for part in along))
    outline, beside = far <= 1.5, (far > max(0.03 * size, 3)) & (far < max(0.08 * size, 7))
    if not outline.any() or not beside.any():
        return 0.0
    return float(strength[outline].mean() / max(strength[beside].mean(), 1e-6)) - 1
