"""What is measured of frames and limbs to tell right answers from wrong ones, on scales that films share."""

import warnings
from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np
from jaxtyping import Bool, Float

from jaxmocap._cache import cached_jit
from jaxmocap.character import Pose, Skeleton, landmark_positions

from ._frame_verdict import FrameResult, VerdictSettings

FRAME_FEATURES = ("view gap", "wide view gap", "alone", "outline", "cost")
LIMB_FEATURES = ("cost", "unseen", "leap", "frame")

_GAPS = (0.002, 0.045)
"""Metres between two views' surfaces below which, and above which, the distance tells no more."""

_FEW = 8
"""Frames that do not tell what is usual."""

_EXPLAINED = 0.2
"""Cost of pixels that look like the person; what is below it tells of the scene, not of the answer."""

_LEAP = 0.15
"""Metres from halfway between its neighbours at which a limb begins to leap out of its way."""


def frame_features(
    results: Sequence[FrameResult], inlier: Bool[np.ndarray, "frame camera"], settings: VerdictSettings
) -> Float[np.ndarray, "frame feature"]:
    """Measure every frame, in the order of `FRAME_FEATURES`; the median of `settings.steady` frames counts.

    Of the cameras that are `inlier`: "view gap" is how far apart two views show the body's surface, as `_log_gap` says,
    and "wide view gap" what of it is above 0; "alone" is 1, and these are 0, where no two views can be compared.
    "outline" is the root of the background that is covered and the person that is not, as a share of the body. "cost"
    is that of Eq. 6, mean over the covered pixels, as far as it is above `_EXPLAINED`. Frames that were passed over
    have the medians of all.
    """
    count, cameras = inlier.shape
    gaps = np.full((count, cameras, cameras), np.nan)
    outlines, costs = np.full((2, count, cameras), np.nan)
    ahead = ~np.eye(cameras, dtype=bool)  # row by row, as `FrameSignals` lists the pairs
    for index, result in enumerate(results):
        if (signals := result.signals) is not None:
            gaps[index][ahead] = signals.view_gaps
            outlines[index], costs[index] = signals.bare + signals.uncovered, signals.costs
    pairs = inlier[:, :, None] & inlier[:, None, :]
    gaps = np.where(pairs, np.fmax(gaps, gaps.swapaxes(1, 2)), np.nan)
    gap = _over_views(np.nanmedian, gaps)
    alone = ~np.isfinite(gap)
    gap = np.where(alone, 0.0, _steady(_log_gap(gap), settings))
    columns = {
        "view gap": gap,
        "wide view gap": np.maximum(gap, 0.0),
        "alone": alone,
        "outline": np.sqrt(_steady(_over_views(np.nanmean, np.where(inlier, outlines, np.nan)), settings)),
        "cost": _beyond(_steady(_over_views(np.nanmean, np.where(inlier, costs, np.nan)), settings)),
    }
    return np.stack([np.asarray(columns[name], float) for name in FRAME_FEATURES], axis=-1)


def limb_features(
    results: Sequence[FrameResult], skeleton: Skeleton, frame_logit: Float[np.ndarray, "frame"]
) -> Float[np.ndarray, "frame limb feature"]:
    """Measure the outer half of every limb in every frame, in the order of `LIMB_FEATURES`.

    "cost" is that of Eq. 6, mean over the outer half's pixels, as far as it is above `_EXPLAINED`; "unseen" the share
    of the outer half that no view shows. "leap" is the logarithm of how many times farther from halfway between the
    frames before and after the limb is than `_LEAP`, or than twice what is usual in this sequence if that is more; 0
    where it is not, or where a neighbour is farther. What is between the last two frames is the last one's if the limb
    was on its way until then. "frame" is the frame's logit.
    """
    costs = np.stack([result.limb_costs for result in results])
    unseen = 1.0 - np.stack([result.limb_seen for result in results])
    columns = {
        "cost": _beyond(np.where(np.isfinite(costs), costs, _or_zero(np.nanmedian, costs))),
        "unseen": np.where(np.isfinite(unseen), unseen, 0.0),
        "leap": _leaps(results, skeleton),
        "frame": np.broadcast_to(frame_logit[:, None], costs.shape),
    }
    return np.stack([np.asarray(columns[name], float) for name in LIMB_FEATURES], axis=-1)


def _leaps(results: Sequence[FrameResult], skeleton: Skeleton) -> Float[np.ndarray, "frame limb"]:
    poses = Pose(
        jax.device_put(np.stack([result.pose.root for result in results])),
        jax.device_put(np.stack([result.pose.angles for result in results])),
    )
    places = np.asarray(_places(skeleton, poses), float)
    bodies, far = list(skeleton.landmark_bodies), np.zeros((len(results), len(skeleton.limb_labels)))
    if len(results) < 3:
        return far
    for limb, group in enumerate(skeleton.limb_labels):
        own = places[:, skeleton.bodies_of(group)[bodies]]
        far[1:-1, limb] = np.linalg.norm(own[1:-1] - 0.5 * (own[:-2] + own[2:]), axis=-1).max(axis=1)
    usual = np.median(far[1:-1], axis=0) if len(results) > _FEW else np.zeros(far.shape[1])
    if len(results) > 3:  # one that is out of its way puts those beside it half as far from halfway
        last = far[-3] < far[-2] / 4
        far[-2:] = np.where(last, 0.0, far[-2]), np.where(last, far[-2], 0.0)
    padded = np.pad(far, ((1, 1), (0, 0)))
    peak = far >= np.maximum(padded[2:], padded[:-2])  # its neighbours are far only because of it
    return np.where(peak, np.log(np.maximum(far / np.maximum(2 * usual, _LEAP), 1.0)), 0.0)


@cached_jit
def _places(skeleton: Skeleton, poses: Pose) -> Float[jax.Array, "frame landmark 3"]:
    return jax.vmap(landmark_positions, (None, 0))(skeleton, poses)


def _log_gap(metres: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
    """Take the logarithm of a distance in units of 3.7 mm: 1 at a centimetre; NaN stays."""
    return 1.0 + np.log(np.clip(metres, *_GAPS) / 0.01)


def _beyond(cost: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
    return np.maximum(cost - _EXPLAINED, 0.0)


def _over_views(mean: Callable[..., Any], values: Float[np.ndarray, "frame *view"]) -> Float[np.ndarray, "frame"]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of frames that show nothing: NaN
        return mean(values.reshape(len(values), -1), axis=1)


def _steady(values: Float[np.ndarray, "frame"], settings: VerdictSettings) -> Float[np.ndarray, "frame"]:
    """Steady what is known over neighbouring frames; what is not is the median of all."""
    return steadied(np.where(np.isfinite(values), values, _or_zero(np.nanmedian, values)), settings.steady)


def _or_zero(mean: Callable[..., Any], values: np.ndarray) -> float:
    return float(mean(values)) if np.isfinite(values).any() else 0.0


def steadied(values: Float[np.ndarray, "frame"], window: int) -> Float[np.ndarray, "frame"]:
    """Take the median of the frames around each: what one frame of many shows is chance."""
    reach = window // 2
    padded = np.pad(values, reach, mode="edge")
    return np.median(np.lib.stride_tricks.sliding_window_view(padded, 2 * reach + 1), axis=1)


def runs(marked: Bool[np.ndarray, "frame"]) -> list[tuple[int, int]]:
    """Find where marked frames begin, and where they have ended."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], marked.astype(int), [0]]))).tolist()
    return list(zip(edges[::2], edges[1::2], strict=True))
