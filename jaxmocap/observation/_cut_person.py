"""The person's mask in one image, from the projected body, the keypoints and the colours (no hand needed).

GrabCut (Rother et al., SIGGRAPH 2004) with three changes, for its two colour mixtures of the whole picture take a
striped shirt before bricks for bricks: colours are compared with what is near (the local classifiers of Bai et al.,
Video SnapCut, SIGGRAPH 2009), the body is a soft prior, and what stays where it is while the person moves is not the
person.
"""

import itertools
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from jaxmocap.geometry import intersection_over_union

_SEED = 0
_RARE = 0.003  # probability added to every colour
_BLOCKS = 4  # that the standard deviation of "near" is divided into
_RUN = 4096  # pixels that are compared with all colours at a time: they stay in the cache
_LIMBS = (
    (2, 3), (3, 4), (5, 6), (6, 7), (9, 10), (10, 11), (12, 13), (13, 14),
    (1, 8), (11, 22), (14, 19), (11, 24), (14, 21),
)  # fmt: skip


@dataclass(frozen=True)
class CutSettings:
    """How the person is cut out of a picture. Lengths are in units of the square root of the prior's area, about 0.4 of
    a standing person's height; weights are in nats.

    Attributes:
        limb: half the width of the lines drawn between keypoints, which belong to the prior.
        prior: distance from the prior's outline that is worth one nat.
        prior_most: nats that it is worth at most.
        skin: how far inside the body's colours count fully.
        sure: deeper in the prior than this everything is the person.
        band: farther from it than this nothing is, which leaves room for hair and clothes.
        near: how local colours are.
        anywhere: share of the colours of the whole body and its surroundings.
        still: weight of what stays where it is.
        colours: how many colours are told apart.
        sharpness: weight of all this against the length of the outline.
        keypoint_confidence: below which a keypoint is not used.
    """

    limb: float = 0.025
    prior: float = 0.03
    prior_most: float = 6.0
    skin: float = 0.008
    sure: float = 0.05
    band: float = 0.15
    near: float = 0.1
    anywhere: float = 0.05
    still: float = 3.0
    colours: int = 48
    sharpness: float = 30.0
    keypoint_confidence: float = 0.3


def person_prior(
    silhouette: Bool[np.ndarray, "height width"],
    keypoints: Float[np.ndarray, "25 3"] | None,
    settings: CutSettings | None = None,
) -> Bool[np.ndarray, "height width"]:
    """Join the projected body and, where it is off, the limbs that keypoints (BODY_25, pixels, confidence) show."""
    settings = CutSettings() if settings is None else settings
    if keypoints is None or not silhouette.any():
        return silhouette
    lines = np.ones(silhouette.shape, np.uint8)
    for limb in _LIMBS:
        if min(keypoints[i, 2] for i in limb) >= settings.keypoint_confidence:
            ends = np.clip(np.round((keypoints[list(limb), :2] - 0.5) * 16), -(2**19), 2**19).astype(int)
            cv2.line(lines, ends[0].tolist(), ends[1].tolist(), 0, 1, cv2.LINE_8, 4)
    if lines.all():
        return silhouette
    reach = settings.limb * np.sqrt(silhouette.sum())
    return silhouette | (cv2.distanceTransform(lines, cv2.DIST_L2, cv2.DIST_MASK_PRECISE) <= reach)


def signed_distance(mask: Bool[np.ndarray, "height width"]) -> Float[np.ndarray, "height width"]:
    """Measure the distance to a mask's outline in pixels, positive inside."""
    inside, outside = (
        cv2.distanceTransform(part.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE) for part in (mask, ~mask)
    )
    return np.where(mask, inside, -outside)


def cut_person(
    image: UInt8[np.ndarray, "height width 3"],
    prior: Bool[np.ndarray, "height width"],
    still: Float[np.ndarray, "height width"] | None = None,
    settings: CutSettings | None = None,
    *,
    seen: Bool[np.ndarray, "height width"] | None = None,
) -> Bool[np.ndarray, "height width"]:
    """Cut out the person's mask; empty where the prior is.

    `prior` is that of `person_prior`, `still` in [0, 1] that of `standing_still`. `seen` is where a detector sees the
    person: it knows hair and wide clothes that the body lacks, where the body knows what is between arm and trunk, so
    that distances to both outlines are averaged. One that is elsewhere (intersection over union below one half) does
    not count.
    """
    settings = CutSettings() if settings is None else settings
    result = np.zeros(prior.shape, bool)
    if not prior.any():
        return result
    size = float(np.sqrt(prior.sum()))
    far = signed_distance(prior)
    if seen is not None and intersection_over_union(prior, seen) > 0.5:
        far = (far + signed_distance(seen)) / 2
    rows, columns = np.nonzero(far >= -3 * settings.band * size)
    window = (slice(rows.min(), rows.max() + 1), slice(columns.min(), columns.max() + 1))
    picture, distance = np.ascontiguousarray(image[window]), far[window] / size
    evidence = local_colour_evidence(picture, distance, size, settings)
    evidence += np.clip(distance / settings.prior, -settings.prior_most, settings.prior_most)
    if still is not None:
        evidence -= np.where(distance <= 0, settings.still * still[window], 0.0)
    labels = np.where(distance > 0, cv2.GC_PR_FGD, cv2.GC_PR_BGD).astype(np.uint8)
    labels[distance > settings.sure] = cv2.GC_FGD
    labels[distance < -settings.band] = cv2.GC_BGD
    found = _smallest_cut(picture, evidence, labels, settings.sharpness)
    result[window] = _touching(found, distance > settings.skin)
    return result


def local_colour_evidence(
    picture: UInt8[np.ndarray, "height width 3"],
    distance: Float[np.ndarray, "height width"],
    size: float,
    settings: CutSettings,
) -> Float[np.ndarray, "height width"]:
    """Compute log p(colour | person, near here) - log p(colour | not the person, near here).

    Both are histograms whose pixels are weighted by a Gaussian around each place and by how surely the prior says where
    they belong. They are counted in blocks of a quarter of the Gaussian's standard deviation and interpolated; counted
    at every pixel they give the same masks but for 0.05 % of their area, in two to three times the time.
    """
    smooth = cv2.cvtColor(cv2.GaussianBlur(picture, (0, 0), 1.0), cv2.COLOR_RGB2LAB)
    label = _quantised(smooth, settings.colours)
    inside = np.clip(distance / settings.skin, 0, 1).astype(np.float32) ** 2
    outside = np.clip(-distance / (settings.band / 2), 0, 1).astype(np.float32) ** 2
    near = settings.near * size
    block = max(1, int(near / _BLOCKS))
    rows, columns = (np.arange(side) // block for side in label.shape)
    shape = (int(rows[-1]) + 1, int(columns[-1]) + 1, settings.colours)
    bins = np.ravel_multi_index((rows[:, None], columns[None], label), shape).ravel()

    def probability(weight: Float[np.ndarray, "height width"]) -> Float[np.ndarray, "rows columns colours"]:
        count = np.bincount(bins, weight.ravel(), int(np.prod(shape))).reshape(shape)
        blurred = cv2.GaussianBlur((count / block**2).astype(np.float32), (0, 0), near / block).reshape(shape)
        local = blurred / (blurred.sum(2, keepdims=True) + 1e-3)
        overall = count.sum((0, 1)) / max(float(weight.sum()), 1e-6)
        return (1 - settings.anywhere) * local + settings.anywhere * overall + _RARE

    return _interpolated(np.log(probability(inside) / probability(outside)), label, block)


def _interpolated(
    values: Float[np.ndarray, "rows columns colours"], label: Int[np.ndarray, "height width"], block: int
) -> Float[np.ndarray, "height width"]:
    """Interpolate each pixel's own colour between the middles of blocks."""
    ends = []
    for side, blocks in zip(label.shape, values.shape[:2], strict=True):
        at = np.clip((np.arange(side) + 0.5) / block - 0.5, 0, blocks - 1)
        low = at.astype(int)
        ends.append(((low, 1 - (at - low)), (np.minimum(low + 1, blocks - 1), at - low)))
    result = np.zeros(label.shape, np.float32)
    for (row, down), (column, along) in itertools.product(*ends):
        result += (down[:, None] * along).astype(np.float32) * values[row[:, None], column, label]
    return result


def _quantised(picture: UInt8[np.ndarray, "height width 3"], colours: int) -> Int[np.ndarray, "height width"]:
    """Nearest of `colours` colours of the picture itself (k-means, always the same)."""
    pixels = picture.reshape(-1, 3).astype(np.float32)
    step = max(1, len(pixels) // 20000)
    cv2.setRNGSeed(_SEED)
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 12, 1.0)
    sample = pixels[::step]
    _, _, means = cv2.kmeans(sample, min(colours, len(sample)), None, criteria, 1, cv2.KMEANS_PP_CENTERS)  # pyright: ignore
    squared = (means**2).sum(1)
    runs = (pixels[start : start + _RUN] for start in range(0, len(pixels), _RUN))
    return np.concatenate([(squared - 2 * run @ means.T).argmin(1) for run in runs]).reshape(picture.shape[:2])


def _smallest_cut(
    picture: UInt8[np.ndarray, "height width 3"],
    evidence: Float[np.ndarray, "height width"],
    labels: UInt8[np.ndarray, "height width"],
    sharpness: float,
) -> Bool[np.ndarray, "height width"]:
    """GrabCut's graph with `evidence` (nats for the person) in place of its mixtures: OpenCV is handed a picture whose
    first channel is the evidence, and two Gaussians whose log ratio is linear in it. The other channels, lightness and
    green to red, only say where an outline is cheap."""
    levels, apart = 3.0, 400.0  # grey levels per nat; distance between the Gaussians' means in grey levels
    lab = cv2.cvtColor(picture, cv2.COLOR_RGB2LAB)
    level = np.clip(np.round(evidence * levels + 128), 0, 255).astype(np.uint8)
    variance = apart * levels / sharpness

    def mixture(mean: float) -> Float[np.ndarray, "1 65"]:
        model = np.zeros((1, 65))
        model[0, 0], model[0, 5:8] = 1.0, (mean, 128, 128)
        model[0, 20:29] = np.diag([variance, 1e6, 1e6]).ravel()
        return model

    labels = labels.copy()
    background, person = mixture(128 - apart / 2), mixture(128 + apart / 2)
    features = np.dstack([level, lab[..., 0], lab[..., 1]])
    cv2.grabCut(features, labels, None, background, person, 1, cv2.GC_EVAL_FREEZE_MODEL)  # pyright: ignore
    return (labels == cv2.GC_FGD) | (labels == cv2.GC_PR_FGD)


def _touching(
    mask: Bool[np.ndarray, "height width"], core: Bool[np.ndarray, "height width"]
) -> Bool[np.ndarray, "height width"]:
    """Keep the connected parts of a mask that reach into `core`."""
    parts = cv2.connectedComponents(mask.astype(np.uint8), connectivity=8)[1].astype(int)
    keep = np.zeros(parts.max() + 1, bool)
    keep[parts[core & mask]] = True
    keep[0] = False
    return keep[parts]
