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

FRAME_FEATURES = ("view gap", "wide view gap", "alone", "wide apart", "outline", "cost")
LIMB_FEATURES = ("cost", "unseen", "leap", "frame")

_GAPS = (0.002, 0.045)
"""Metres between two views' surfaces below which, and above which, the distance tells no more."""

_FEW = 8
"""Frames that do not tell what is usual."""

_EXPLAINED = 0.2
"""Cost of pixels that look like the person; what is below it tells of the scene, not of the answer."""

_LEAP = 0.15
"""Metres from between its neighbours at which a limb begins to leap out of its way."""

_SWING = 60.0
"""Metres per second squared that fast wrists and ankles reach, so that where frames lie far apart in time more room is
between them."""


def frame_features(
    results: Sequence[FrameResult], inlier: Bool[np.ndarray, "frame camera"], settings: VerdictSettings
) -> Float[np.ndarray, "frame feature"]:
    """Measure every frame, in the order of `FRAME_FEATURES`; the median of `settings.steady` frames counts.

    Of the cameras that are `inlier`: "view gap" is how far apart two views show the body's surface, as `_log_gap` says,
    and "wide view gap" what of it is above 0. Where no two views can be compared these are 0, and 1 is "alone", if a
    single camera shows the body, or "wide apart", if several do. "outline" is the root of the background that is
    covered and the person that is not, as a share of the body. "cost" is that of Eq. 6, mean over the covered pixels,
    as far as it is above `_EXPLAINED`. Frames that were passed over lie between those around them.
    """
    looked_at = [result.signals is not None for result in results]
    if not any(looked_at):
        return np.zeros((len(results), len(FRAME_FEATURES)))
    inlier, cameras = inlier[looked_at], inlier.shape[1]
    count = len(inlier)
    gaps = np.full((count, cameras, cameras), np.nan)
    outlines, costs = np.full((2, count, cameras), np.nan)
    ahead = ~np.eye(cameras, dtype=bool)  # row by row, as `FrameSignals` lists the pairs
    for index, signals in enumerate(result.signals for result in results if result.signals is not None):
        gaps[index][ahead] = signals.view_gaps
        outlines[index], costs[index] = signals.bare + signals.uncovered, signals.costs
    pairs = inlier[:, :, None] & inlier[:, None, :]
    gaps = np.where(pairs, np.fmax(gaps, gaps.swapaxes(1, 2)), np.nan)
    gap = _over_views(np.nanmedian, gaps)
    apart = ~np.isfinite(gap)
    single = (inlier & (costs < 1.0)).sum(axis=1) < 2  # a view that shows nothing of the body costs 1
    gap = np.where(apart, 0.0, _steady(_log_gap(gap), settings))
    columns = {
        "view gap": gap,
        "wide view gap": np.maximum(gap, 0.0),
        "alone": apart & single,
        "wide apart": apart & ~single,
        "outline": np.sqrt(_steady(_over_views(np.nanmean, np.where(inlier, outlines, np.nan)), settings)),
        "cost": _beyond(_steady(_over_views(np.nanmean, np.where(inlier, costs, np.nan)), settings)),
    }
    return _between(np.stack([np.asarray(columns[name], float) for name in FRAME_FEATURES], axis=-1), looked_at)


def limb_features(
    results: Sequence[FrameResult], skeleton: Skeleton, frame_logit: Float[np.ndarray, "frame"]
) -> Float[np.ndarray, "frame limb feature"]:
    """Measure the outer half of every limb in every frame, in the order of `LIMB_FEATURES`.

    "cost" is that of Eq. 6, mean over the outer half's pixels, as far as it is above `_EXPLAINED`; "unseen" the share
    of the outer half that no view shows. "leap" is the logarithm of how many times farther the limb is from where the
    frames before and after would have it than it may be, as `_leaps` says; 0 where it is not. "frame" is the frame's
    logit. Frames that were passed over lie between those around them, and do not leap.
    """
    looked_at = [result.signals is not None for result in results]
    costs = np.stack([result.limb_costs for result in results])
    unseen = 1.0 - np.stack([result.limb_seen for result in results])
    columns = {
        "cost": _beyond(np.where(np.isfinite(costs), costs, _or_zero(np.nanmedian, costs))),
        "unseen": np.where(np.isfinite(unseen), unseen, 0.0),
        "leap": np.zeros_like(unseen),
        "frame": np.broadcast_to(frame_logit[:, None], costs.shape),
    }
    seen = [result for result in results if result.signals is not None]
    for name, values in columns.items():
        columns[name] = _between(values[looked_at], looked_at)
    columns["leap"][looked_at] = _leaps(seen, skeleton)
    return np.stack([columns[name] for name in LIMB_FEATURES], axis=-1)


def _between(
    values: Float[np.ndarray, "looked *feature"], looked_at: Sequence[bool]
) -> Float[np.ndarray, "frame *feature"]:
    """Interpolate what was measured of the frames that were looked at for all frames; 0 where there are none."""
    if not len(values):
        return np.zeros((len(looked_at), *values.shape[1:]))
    at, frames = np.flatnonzero(looked_at), np.arange(len(looked_at))
    columns = values.reshape(len(at), -1).T.astype(float)
    filled = np.stack([np.interp(frames, at, column) for column in columns], axis=1)
    return filled.reshape(len(frames), *values.shape[1:])


def _leaps(results: Sequence[FrameResult], skeleton: Skeleton) -> Float[np.ndarray, "frame limb"]:
    """Measure how limbs leap: for a frame or two they are away from the straight way between the frames around.

    The logarithm of the distance over what is allowed: `_LEAP`, twice what is usual in this sequence, or how far a limb
    comes with `_SWING` on such a way and back. Where a neighbour is farther it is 0, for it is far only because of the
    other. What is between the last two frames is the last one's if the limb was on its way until then, and of the first
    two the same.
    """
    limbs = [skeleton.bodies_of(group)[list(skeleton.landmark_bodies)] for group in skeleton.limb_labels]
    if len(results) < 3:
        return np.zeros((len(results), len(limbs)))
    poses = Pose(
        jax.device_put(np.stack([result.pose.root for result in results])),
        jax.device_put(np.stack([result.pose.angles for result in results])),
    )
    places = np.asarray(_places(skeleton, poses), float)
    times = np.array([result.timestamp for result in results])
    away, room = _away(places, times, limbs, 1)
    usual = np.median(away[1:-1], axis=0) if len(results) > _FEW else np.zeros(len(limbs))
    if len(results) > 3:  # one that is out of its way puts those beside it half as far from halfway
        for end, beside, third in ((0, 1, 2), (-1, -2, -3)):
            own = away[third] < away[beside] / 4
            away[end], away[beside] = np.where(own, away[beside], 0.0), np.where(own, 0.0, away[beside])
            room[end] = room[beside]
        both, room_of_both = _away(places, times, limbs, 2)
        away, room = np.where(both > away, both, away), np.where(both > away, room_of_both, room)
    around = np.pad(away, ((1, 1), (0, 0)))
    peak = away >= np.maximum(around[2:], around[:-2])
    return np.where(peak, np.log(np.maximum(away / np.maximum(np.maximum(2 * usual, _LEAP), room), 1.0)), 0.0)


def _away(
    places: Float[np.ndarray, "frame landmark 3"],
    times: Float[np.ndarray, "frame"],
    limbs: Sequence[Bool[np.ndarray, "landmark"]],
    length: int,
) -> tuple[Float[np.ndarray, "frame limb"], Float[np.ndarray, "frame limb"]]:
    """Measure how far limbs are, for so many frames together, from the way between the frames around them, metres.

    Of two frames the nearer counts, less what they are apart. Beside it stands how far they may come by `_SWING`.
    """
    away, room = np.zeros((2, len(places), len(limbs)))
    for first in range(1, len(places) - length):
        inside, stop = slice(first, first + length), first + length
        before, after = times[inside] - times[first - 1], times[stop] - times[inside]
        share = np.where(before + after > 0, before, 1.0) / np.where(before + after > 0, before + after, 2.0)
        way = places[first - 1] + share[:, None, None] * (places[stop] - places[first - 1])
        off = places[inside] - way
        together = np.linalg.norm(off, axis=-1).min(axis=0) - np.linalg.norm(off[-1] - off[0], axis=-1)
        of_limbs = np.array([together[limb].max() for limb in limbs])
        allowed = np.broadcast_to(0.5 * _SWING * (before * after)[:, None], away[inside].shape)
        farther = of_limbs > away[inside]
        room[inside] = np.where(farther, allowed, room[inside])
        away[inside] = np.where(farther, of_limbs, away[inside])
    return away, room


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
