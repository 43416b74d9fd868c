"""Background features matched between two frames of a camera, and the empty scene seen through them (Fig. 5)."""

from dataclasses import dataclass, field
from typing import Literal

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

Matches = tuple[Float[np.ndarray, "_ 2"], Float[np.ndarray, "_ 2"]]
"""Pixels (x, y) in the first and in the second frame, centre of the first pixel at (0.5, 0.5)."""


@dataclass(frozen=True)
class FeatureSettings:
    """How background features are found and filtered.

    Attributes:
        count: SIFT features per frame.
        scales: image scales tried in turn until `enough` matches survive; half resolution takes a fifth of the time and
            usually suffices.
        enough: matches.
        ratio: of the nearest to the second nearest descriptor's distance.
        model: of the global check: "fundamental", which keeps parallax, or "homography".
        threshold: of the global check, pixels.
        blocks: the image is cut into blocks x blocks, and each asks for a common affine motion; 0 turns that off.
        block_threshold: of that motion, pixels.
        minimum: direct matches below which tracks from the previous frame are added.
        mask_growth: pixels by which the person mask grows.
        mask_growth_to: the same for the second frame, where the mask is a prediction, as a share of the image height.
    """

    count: int = 3000
    scales: tuple[float, ...] = (0.5, 1.0)
    enough: int = 100
    ratio: float = 0.8
    model: Literal["fundamental", "homography"] = "fundamental"
    threshold: float = 3.0
    blocks: int = 4
    block_threshold: float = 2.0
    minimum: int = 50
    mask_growth: int = 7
    mask_growth_to: float = 0.03


@dataclass(frozen=True)
class FrameFeatures:
    """Keypoints and descriptors of one frame, computed when first asked for and kept: keep it for a selected frame.

    `mask` marks pixels that are not background, already grown.
    """

    image: UInt8[np.ndarray, "height width 3"]
    mask: Bool[np.ndarray, "height width"] | None = None
    settings: FeatureSettings = FeatureSettings()
    _found: dict[float, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict, repr=False, compare=False)

    def at(self, scale: float) -> tuple[Float[np.ndarray, "feature 2"], Float[np.ndarray, "feature 128"]]:
        """Return what is found at an image scale: pixels of the full image, and SIFT descriptors."""
        if scale not in self._found:
            self._found[scale] = self._detect(scale)
        return self._found[scale]

    def _detect(self, scale: float) -> tuple[np.ndarray, np.ndarray]:
        grey = cv2.cvtColor(self.image, cv2.COLOR_RGB2GRAY)
        allowed = None if self.mask is None else np.where(self.mask, 0, 255).astype(np.uint8)
        if scale != 1:
            size = (round(grey.shape[1] * scale), round(grey.shape[0] * scale))
            grey = cv2.resize(grey, size, interpolation=cv2.INTER_AREA)
            allowed = None if allowed is None else cv2.resize(allowed, size, interpolation=cv2.INTER_NEAREST)
        # Without the precise upscale every keypoint is a quarter of a pixel too far right and down.
        sift = cv2.SIFT.create(self.settings.count, enable_precise_upscale=True)
        keypoints, descriptors = sift.detectAndCompute(grey, allowed)
        if not keypoints:
            return np.zeros((0, 2)), np.zeros((0, 128), np.float32)
        factor = (self.image.shape[1] / grey.shape[1], self.image.shape[0] / grey.shape[0])
        return (np.array([point.pt for point in keypoints]) + 0.5) * factor, descriptors


def frame_features(
    image: UInt8[np.ndarray, "height width 3"],
    mask: Bool[np.ndarray, "height width"] | None,
    growth: int,
    settings: FeatureSettings | None = None,
) -> FrameFeatures:
    """Find features of a frame outside a mask that is first grown by `growth` pixels."""
    settings = FeatureSettings() if settings is None else settings
    return FrameFeatures(image, None if mask is None else _grown(mask, growth), settings)


def match_background(
    image_from: UInt8[np.ndarray, "height width 3"] | FrameFeatures,
    mask_from: Bool[np.ndarray, "height width"] | None,
    image_to: UInt8[np.ndarray, "height_to width_to 3"],
    mask_to: Bool[np.ndarray, "height_to width_to"] | None,
    settings: FeatureSettings | None = None,
    *,
    previous: tuple[UInt8[np.ndarray, "height_to width_to 3"], Matches] | None = None,
) -> Matches:
    """Match background points of a selected frame with another frame (Sec. 4.1, the features of [51]).

    SIFT with a ratio test, a global epipolar check, then a local one per block. `mask_from` is the person in the
    selected frame, `mask_to` the person's prediction in the other frame; both are grown here. Pass the selected frame
    as `FrameFeatures` (its mask is then used) to compute its features once. `previous` is the frame before `image_to`
    with its matches to the selected frame: if fewer than `settings.minimum` direct matches remain, these points are
    tracked on (Lucas-Kanade, checked forwards and backwards) and added.
    """
    settings = FeatureSettings() if settings is None else settings
    first = image_from
    if not isinstance(first, FrameFeatures):
        first = frame_features(first, mask_from, settings.mask_growth, settings)
    second = frame_features(image_to, mask_to, round(settings.mask_growth_to * image_to.shape[0]), settings)
    matches: Matches = (np.zeros((0, 2)), np.zeros((0, 2)))
    for scale in settings.scales:
        found = _consistent(_matched(first.at(scale), second.at(scale), settings.ratio), image_to.shape, settings)
        if len(found[0]) > len(matches[0]):
            matches = found
        if len(matches[0]) >= settings.enough:
            break
    if previous is not None and len(matches[0]) < settings.minimum:
        tracked = track_points(previous[0], image_to, previous[1], second.mask)
        matches = np.concatenate([matches[0], tracked[0]]), np.concatenate([matches[1], tracked[1]])
    return matches


def track_points(
    image_previous: UInt8[np.ndarray, "height width 3"],
    image_to: UInt8[np.ndarray, "height width 3"],
    matches: Matches,
    mask_to: Bool[np.ndarray, "height width"] | None = None,
) -> Matches:
    """Follow the second points of `matches` from `image_previous` into `image_to`; lost and masked ones are dropped.

    Pyramidal Lucas-Kanade; a point is kept if tracking it back ends within half a pixel of where it began.
    """
    points_from, points = matches
    if len(points) == 0:
        return matches
    previous, current = (cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) for image in (image_previous, image_to))
    start = (points - 0.5).astype(np.float32)[:, None]
    forward, found = _lucas_kanade(previous, current, start)
    back, found_back = _lucas_kanade(current, previous, forward)
    keep = found & found_back
    keep &= np.linalg.norm((back - start)[:, 0], axis=1) < 0.5
    points_to = forward[:, 0].astype(np.float64) + 0.5
    height, width = current.shape
    keep &= (points_to >= 0).all(axis=1) & (points_to[:, 0] < width) & (points_to[:, 1] < height)
    if mask_to is not None:
        keep[keep] = ~mask_to[points_to[keep, 1].astype(int), points_to[keep, 0].astype(int)]
    return points_from[keep], points_to[keep]


def _lucas_kanade(first: np.ndarray, second: np.ndarray, start: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where points (n, 1, 2) of one grey image are in another, in OpenCV's pixels, and which were found."""
    blank = np.zeros_like(start)
    moved, found, _ = cv2.calcOpticalFlowPyrLK(first, second, start, blank, winSize=(21, 21), maxLevel=3)
    return moved, found.ravel() > 0


def _grown(mask: np.ndarray, growth: int) -> Bool[np.ndarray, "height width"]:
    """Grow a mask by every pixel within `growth` of it."""
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * growth + 1, 2 * growth + 1))
    return cv2.dilate((np.asarray(mask) != 0).astype(np.uint8), kernel) > 0


def _matched(first: tuple[np.ndarray, np.ndarray], second: tuple[np.ndarray, np.ndarray], ratio: float) -> Matches:
    """Pairs whose descriptors are nearest by a margin (Lowe's ratio test), by one matrix product."""
    (points_from, described_from), (points_to, described_to) = first, second
    if len(points_from) == 0 or len(points_to) < 2:
        return np.zeros((0, 2)), np.zeros((0, 2))
    squared = described_from @ described_to.T
    squared *= -2
    squared += np.sum(described_to**2, axis=1)
    rows = np.arange(len(squared))
    nearest = np.argmin(squared, axis=1)
    best = squared[rows, nearest]
    squared[rows, nearest] = np.inf
    own = np.sum(described_from**2, axis=1)
    keep = best + own < ratio**2 * (np.min(squared, axis=1) + own)
    return points_from[keep], points_to[nearest[keep]]


def _inliers(matches: Matches, settings: FeatureSettings, method: int) -> np.ndarray | None:
    if settings.model == "homography":
        return cv2.findHomography(*matches, method, settings.threshold)[1]
    return cv2.findFundamentalMat(*matches, method, settings.threshold, 0.999, 5000)[1]


def _consistent(matches: Matches, shape: tuple[int, ...], settings: FeatureSettings) -> Matches:
    """Keep the matches that agree with a global model and with their block."""
    points_from, points_to = matches
    if len(points_from) < 8:
        return np.zeros((0, 2)), np.zeros((0, 2))
    try:
        inlier = _inliers(matches, settings, cv2.USAC_MAGSAC)
    except cv2.error:  # MAGSAC asserts where its own refinement of a model finds none
        inlier = _inliers(matches, settings, cv2.RANSAC)
    if inlier is None:
        return np.zeros((0, 2)), np.zeros((0, 2))
    points_from, points_to = points_from[inlier.ravel() > 0], points_to[inlier.ravel() > 0]
    keep = np.ones(len(points_from), bool)
    size = np.array([shape[1], shape[0]]) / max(settings.blocks, 1)
    for row in range(settings.blocks):
        for column in range(settings.blocks):
            offset = points_from / size - (column + 0.5, row + 0.5)
            around = np.abs(offset).max(axis=1) <= 1
            inside = np.abs(offset).max(axis=1) <= 0.5
            if around.sum() < 8 or not inside.any():
                continue
            agreed = cv2.estimateAffine2D(
                points_from[around], points_to[around], ransacReprojThreshold=settings.block_threshold
            )[1]
            good = np.zeros(len(points_from), bool)
            good[around] = agreed.ravel() > 0
            keep &= good | ~inside
    return points_from[keep], points_to[keep]
