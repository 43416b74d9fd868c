"""Light that changes while filming: flashes, clouds, and phones that set exposure and white balance by themselves."""

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from ._flow import flow_agrees, flow_both_ways

_DARK, _BRIGHT = 16, 240


STILL = 0.05
"""Changes of the logarithm of a channel below this are left alone, so that in steady light every picture stays as it
is; from twice that on they are taken out wholly."""

WIDTH, OVERLAP = 240, 0.5
"""Pixels across at which pictures are compared, and the share of them that has to show the same."""


class LightMeter(NamedTuple):
    """One camera's light so far: logarithms per channel of an earlier, `anchor` picture and of the `last` one, against
    the first. Pictures are compared with an anchor as long as they share enough, so that errors do not add up from
    frame to frame."""

    anchor: UInt8[np.ndarray, "rows columns 3"]
    anchor_light: Float[np.ndarray, "3"]
    last: UInt8[np.ndarray, "rows columns 3"]
    light: Float[np.ndarray, "3"]

    @staticmethod
    def begin(image: UInt8[np.ndarray, "height width 3"]) -> "LightMeter":
        """Take the light of this picture as the measure of all others."""
        small = _small(image)
        return LightMeter(small, np.zeros(3), small, np.zeros(3))

    def at(self, image: UInt8[np.ndarray, "height width 3"]) -> "LightMeter":
        """Read the light of the next picture. Where nothing can be compared it stays."""
        small = _small(image)
        change, shared = light_change(self.anchor, small)
        if shared >= OVERLAP:
            return self._replace(last=small, light=self.anchor_light + change)
        change, shared = light_change(self.last, small)
        light = self.light + change if shared >= 0.2 * OVERLAP else self.light
        return LightMeter(self.last, self.light, small, light)

    def factors(self) -> Float[np.ndarray, "3"]:
        """Compute what the picture has to be divided by, per channel; 1 in steady light."""
        size = np.abs(self.light)
        return np.exp(np.sign(self.light) * np.clip(2 * (size - STILL), 0, size))


def light_change(
    before: UInt8[np.ndarray, "rows columns 3"], after: UInt8[np.ndarray, "rows columns 3"]
) -> tuple[Float[np.ndarray, "3"], float]:
    """Take the median change of the log of each channel over the surroundings both pictures show, and their share."""
    first, second = (cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY) for picture in (before, after))
    gain = max(float(np.median(first)), 1.0) / max(float(np.median(second)), 1.0)
    second = np.clip(second * gain, 0, 255).astype(np.uint8)
    forward, backward = flow_both_ways(first, second, "fast")
    rows, columns = np.mgrid[: first.shape[0], : first.shape[1]].astype(np.float32)
    there = columns + forward[..., 0], rows + forward[..., 1]
    warped = cv2.remap(after.astype(np.float32), *there, cv2.INTER_LINEAR, borderValue=(0, 0, 0, 0))
    here = before.astype(np.float32)
    both = np.concatenate([here, warped], axis=-1)
    good = flow_agrees(forward, backward) & (both.min(-1) > _DARK) & (both.max(-1) < _BRIGHT)
    if not good.any():
        return np.zeros(3), 0.0
    return np.median(np.log(warped[good] / here[good]), axis=0), float(good.mean())


def relit(
    images: Sequence[UInt8[np.ndarray, "height width 3"]], factors: Float[np.ndarray, "camera 3"]
) -> list[UInt8[np.ndarray, "height width 3"]]:
    """Divide the images by a factor per camera and channel; those of factor 1 stay as they are."""
    levels = np.arange(256)[:, None]
    tables = [np.rint(np.clip(levels / factor, 0, 255)).astype(np.uint8)[None] for factor in factors]
    pairs = zip(images, factors, tables, strict=True)
    return [image if (factor == 1).all() else cv2.LUT(image, table) for image, factor, table in pairs]


def _small(image: np.ndarray) -> UInt8[np.ndarray, "rows columns 3"]:
    rows = max(round(image.shape[0] * WIDTH / image.shape[1]), 16)
    return cv2.resize(image, (WIDTH, rows), interpolation=cv2.INTER_AREA)
