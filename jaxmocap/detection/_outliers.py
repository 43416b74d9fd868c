"""Points that jump away for a single picture, told by their neighbours in time."""

import numpy as np
from jaxtyping import Float64, Int64

_SHARE = 0.06  # of the region's side; what a point may deviate from its neighbours' mean in any case
_USUAL = 4.0  # times what it deviates in the pictures around
_AROUND = 7  # pictures before and after


def without_outliers(
    points: Float64[np.ndarray, "frame point 3"],
    sides: Float64[np.ndarray, " frame"],
    frames: Int64[np.ndarray, " frame"],
) -> Float64[np.ndarray, "frame point"]:
    """Return the confidences of points over time, 0 for a point that for one picture is where it cannot be.

    It is one that lies farther from the mean of its neighbours in time than 6 % of the region's side (`sides`, pixels),
    than four times what is usual around, and than its neighbours lie from theirs; a jump that lasts is believed.
    `frames` are the pictures' numbers; neighbours are not more than the usual step apart.
    """
    confidence = points[..., 2].copy()
    if len(points) < 3:
        return confidence
    seen, steps = confidence > 0, np.diff(frames)
    near = steps <= 1.5 * np.median(steps)
    deviation = np.full(confidence.shape, np.nan)
    inner = seen[:-2] & seen[1:-1] & seen[2:] & (near[:-1] & near[1:])[:, None]
    middle = (points[:-2, :, :2] + points[2:, :, :2]) / 2
    deviation[1:-1] = np.where(inner, np.linalg.norm(points[1:-1, :, :2] - middle, axis=-1), np.nan)
    padded = np.pad(deviation, ((_AROUND, _AROUND), (0, 0)), constant_values=np.nan)
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * _AROUND + 1, axis=0)
    known = np.isfinite(windows).any(-1)
    usual = np.zeros(deviation.shape)
    usual[known] = np.nanmedian(windows[known], axis=-1)
    beside = np.nan_to_num(np.maximum(_shifted(deviation, 1), _shifted(deviation, -1)))
    limit = np.maximum(_SHARE * sides[:, None], _USUAL * usual)
    wrong = np.nan_to_num(deviation) > np.maximum(limit, 1.5 * beside)
    confidence[wrong] = 0.0
    return confidence


def _shifted(values: np.ndarray, step: int) -> np.ndarray:
    """Values of the frame `step` before, NaN where there is none."""
    result = np.full(values.shape, np.nan)
    if step > 0:
        result[step:] = values[:-step]
    else:
        result[:step] = values[-step:]
    return result
