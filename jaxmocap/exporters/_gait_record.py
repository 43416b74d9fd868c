"""What is said of somebody's gait: events, strides, contact and their means."""

from dataclasses import dataclass
from typing import Any

import numpy as np

_FIGURES = ("duration", "length", "speed", "step_length", "step_width", "stance", "double_support")


@dataclass(frozen=True)
class GaitEvent:
    """A foot that strikes the ground or leaves it.

    Attributes:
        foot: "left" or "right".
        kind: "strike" or "off".
        seconds: when, as the motion's timestamps count.
        frame: the nearest frame.
        confidence: the lesser of the heel's and the toe's, in [0, 1].
        trusted: whether that frame is.
    """

    foot: str
    kind: str
    seconds: float
    frame: int
    confidence: float
    trusted: bool


@dataclass(frozen=True)
class Stride:
    """From one strike of a foot to its next; seconds, metres, shares of the stride.

    Attributes:
        foot: "left" or "right".
        start: of the stride, seconds.
        duration: seconds.
        length: from where the heel stood to where it stands next, over the ground.
        speed: m/s.
        step_length: of the step that ends it, from the other heel.
        step_width: between the heels, across the way of walking.
        stance: share in which the foot stands.
        double_support: share in which both do; NaN where the other foot's events are not known.
        length_sd: standard deviation of the length, by the covariances of the heels; NaN where those are not known.
        step_length_sd: the same, of the step's length.
        step_width_sd: the same, of its width.
        confidence: the least of the pelvis', heels' and toes' over the stride's frames, in [0, 1].
        trusted: whether all of these frames are "ok" and no foot is lost in them; means leave out what is not.
    """

    foot: str
    start: float
    duration: float
    length: float
    speed: float
    step_length: float
    step_width: float
    stance: float
    double_support: float
    length_sd: float
    step_length_sd: float
    step_width_sd: float
    confidence: float
    trusted: bool


@dataclass(frozen=True)
class Gait:
    """What a motion shows of walking; everything is empty where nobody walks.

    Attributes:
        events: in order of time.
        strides: in order of time.
        contact: per foot its intervals on the ground, seconds.
    """

    events: tuple[GaitEvent, ...]
    strides: tuple[Stride, ...]
    contact: dict[str, list[tuple[float, float]]]

    def summary(self) -> dict[str, Any]:
        """Summarise the strides that are trusted: mean and standard deviation of each figure, and the cadence.

        `strides` counts them, `left_out` those that are not trusted. Empty without any stride.
        """
        if not self.strides:
            return {}
        rows = [{name: getattr(stride, name) for name in _FIGURES} for stride in self.strides if stride.trusted]
        counts = {"strides": len(rows), "left_out": len(self.strides) - len(rows)}
        if not rows:
            return counts
        figures = {name: np.array([row[name] for row in rows]) for name in _FIGURES}
        figures = {name: values[np.isfinite(values)] for name, values in figures.items()}
        means = {
            name: {"mean": float(values.mean()), "sd": float(values.std(ddof=1)) if len(values) > 1 else None}
            for name, values in figures.items()
            if len(values)
        }
        confidence = min(stride.confidence for stride in self.strides if stride.trusted)
        return {**counts, "confidence": confidence, "cadence": 120 / means["duration"]["mean"], **means}
