"""What stays where it is while the person moves, seen in other frames of the same camera."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

_FEWEST = 12
_SAME = 12.0  # grey levels
_VOTES = 3
_FEATURES = 1500


class OtherFrame(NamedTuple):
    """Another frame of a camera, and its SIFT points and descriptors."""

    image: UInt8[np.ndarray, "height width 3"]
    features: tuple[Any, Any]


def other_frame(image: UInt8[np.ndarray, "height width 3"]) -> OtherFrame:
    """Find a frame's features once, for all frames that it is laid over."""
    return OtherFrame(image, _sift(image, None))


def standing_still(
    image: UInt8[np.ndarray, "height width 3"],
    person: Bool[np.ndarray, "height width"],
    others: Sequence[OtherFrame],
) -> Float[np.ndarray, "height width"]:
    """Measure per pixel, in [0, 1], how surely it shows the background.

    That is in how many `others` the same colour is at the same place, three being enough.

    Each of them is laid over `image` by the homography of its SIFT matches (RANSAC), which `person` takes no part in.
    Parallax makes pixels differ and so says nothing. A plain dark shirt looks the same wherever it moves: inside the
    projected body this is no evidence.
    """
    votes = np.zeros(image.shape[:2], np.float32)
    if not others:
        return votes
    elsewhere = np.where(cv2.dilate(person.astype(np.uint8), np.ones((15, 15))) > 0, 0, 255).astype(np.uint8)
    known = _sift(image, elsewhere)
    blurred = cv2.GaussianBlur(image, (0, 0), 1.5)
    for other, features in others:
        here = _homography(features, known)
        if here is None:
            continue
        size = (image.shape[1], image.shape[0])
        laid = cv2.GaussianBlur(cv2.warpPerspective(other, here, size), (0, 0), 1.5)
        seen = cv2.warpPerspective(np.full(other.shape[:2], 255, np.uint8), here, size) == 255
        differs = cv2.blur(cv2.absdiff(laid, blurred).max(2).astype(np.float32), (3, 3))
        votes += seen & (differs < _SAME)
    return np.clip(votes / _VOTES, 0, 1)


def _sift(image: np.ndarray, where: np.ndarray | None) -> tuple[Any, Any]:
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    return cv2.SIFT_create(_FEATURES).detectAndCompute(grey, where)  # pyright: ignore


def _homography(found: tuple, known: tuple) -> Float[np.ndarray, "3 3"] | None:
    (points, descriptors), (points_known, descriptors_known) = found, known
    if descriptors is None or descriptors_known is None or len(descriptors_known) < 2:
        return None
    pairs = cv2.BFMatcher(cv2.NORM_L2).knnMatch(descriptors, descriptors_known, k=2)
    good = [first for first, second in pairs if first.distance < 0.8 * second.distance]
    if len(good) < _FEWEST:
        return None
    source = np.array([points[match.queryIdx].pt for match in good], np.float32)
    target = np.array([points_known[match.trainIdx].pt for match in good], np.float32)
    cv2.setRNGSeed(0)
    here, inliers = cv2.findHomography(source, target, cv2.RANSAC, 3.0)
    return None if here is None or int(inliers.sum()) < _FEWEST else here
