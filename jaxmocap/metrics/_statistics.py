"""Summaries of distances, in centimetres."""

import numpy as np
from jaxtyping import Float

_CM = 100.0


def marker_statistics(distances: Float[np.ndarray, "frame marker"]) -> dict[str, float]:
    """The paper's figures: mean, min and max over frames of the mean over visible markers; `p95` over single points."""
    per_frame = frame_means(distances)
    per_frame = per_frame[np.isfinite(per_frame)] * _CM
    return {
        "mean": float(per_frame.mean()),
        "min": float(per_frame.min()),
        "max": float(per_frame.max()),
        "p95": float(np.percentile(distances[np.isfinite(distances)], 95) * _CM),
    }


def joint_statistics(distances: Float[np.ndarray, "frame joint"]) -> dict[str, float]:
    """Mean, 95th percentile and maximum over single points."""
    points = distances[np.isfinite(distances)] * _CM
    return {"mean": float(points.mean()), "p95": float(np.percentile(points, 95)), "max": float(points.max())}


def frame_means(distances: Float[np.ndarray, "frame point"]) -> Float[np.ndarray, " frame"]:
    """The mean over finite points of each frame, NaN where a frame has none."""
    finite = np.isfinite(distances)
    count = finite.sum(1)
    total = np.where(finite, distances, 0.0).sum(1)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)
