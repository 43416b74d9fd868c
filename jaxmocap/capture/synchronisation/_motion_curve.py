"""How much and which way the picture's contents move, over time, with the camera's own motion taken off."""

from collections.abc import Callable, Collection
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float32, Float64

from .._video import VideoIndex, luma_frames

_LONG_SIDE = 160  # pixels
_INLIER = 0.3  # pixels
_ROUNDS = 5
_FLOOR = 0.01  # picture heights per second, below which motion is noise


@dataclass(frozen=True, eq=False)
class MotionCurve:
    """Two numbers per pair of successive frames, at the `seconds` (since the video's first frame) between them: the
    mean velocity downwards, in picture heights per second, and the logarithm of the root mean square speed.

    Up and down are the same for all upright cameras, wherever they stand, and so is a good part of how fast."""

    index: VideoIndex
    seconds: Float64[np.ndarray, " step"]
    values: Float64[np.ndarray, "step channel"]


def measure_motion(
    index: VideoIndex, flashes: Collection[int] = (), progress: Callable[[float], None] | None = None
) -> MotionCurve:
    """Decode a video once. Optical flow (DIS) between small frames, less the affine motion that most of the picture
    follows. Around frames in which a flash begins, whose flow means nothing, the curve is interpolated.

    `progress` is told the seconds done. Raises `InputError` where the video cannot be decoded.
    """
    flow = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_ULTRAFAST)
    scale = _LONG_SIDE / max(index.size)
    width, height = (max(round(side * scale), 16) for side in index.size)
    seconds, values, last = [], [], None
    for frame, luma in luma_frames(index):
        upright = np.rot90(luma, index.quarter_turns)
        small = cv2.resize(np.ascontiguousarray(upright), (width, height), interpolation=cv2.INTER_AREA)
        if last is not None and frame > last[0]:
            step = float(index.seconds[frame] - index.seconds[last[0]])
            own = _without_camera(flow.calc(last[1], small, np.zeros((height, width, 2), np.float32))) / (height * step)
            speed = np.sqrt(np.mean(np.sum(own**2, axis=-1)))
            values.append((np.mean(own[..., 1]), np.log(speed + _FLOOR)))
            seconds.append((index.seconds[frame] + index.seconds[last[0]]) / 2)
            for flash in flashes:
                if flash - 1 <= frame <= flash + 4:
                    values[-1] = (np.nan, np.nan)
        last = frame, small
        if progress is not None:
            progress(float(index.seconds[frame]))
    curve = np.array(values, np.float64).reshape(-1, 2)
    known = np.isfinite(curve[:, 0])
    times = np.array(seconds, np.float64)
    if known.any():
        curve = np.stack([np.interp(times, times[known], channel[known]) for channel in curve.T], axis=1)
    else:
        curve = np.zeros_like(curve)
    return MotionCurve(index, times, curve)


def _without_camera(flow: Float32[np.ndarray, "height width 2"]) -> Float64[np.ndarray, "height width 2"]:
    """Flow less its dominant affine part, found by least squares, reweighted for a Cauchy residual."""
    height, width = flow.shape[:2]
    y, x = np.mgrid[:height, :width]
    design = np.stack([np.ones(height * width), x.ravel() / width - 0.5, y.ravel() / height - 0.5], axis=1)
    target = flow.reshape(-1, 2).astype(np.float64)
    weight = np.ones(len(design))
    residual = target
    for _ in range(_ROUNDS):
        weighted = design * weight[:, None]
        affine = np.linalg.solve(weighted.T @ design + 1e-9 * np.eye(3), weighted.T @ target)
        residual = target - design @ affine
        weight = 1 / (1 + np.sum(residual**2, axis=1) / _INLIER**2)
    return residual.reshape(flow.shape)
