"""Spatio-temporal figures of gait: foot strikes, foot offs, strides, cadence, contact."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.ndimage import gaussian_filter1d
from scipy.signal import butter, find_peaks, sosfiltfilt

from jaxmocap._files import write_json
from jaxmocap.character import stature
from jaxmocap.motion import Motion

from ._exporter import ExportForm

_RATE = 100.0  # samples per second that the events are looked for in
_CUT = 6.0  # Hz, of the low-pass filter usual for gait
_AHEAD = 0.4  # seconds over which the way of walking is averaged
_SLOWEST = 0.25  # m/s
_REACH = 0.1  # metres by which a foot passes the pelvis, to the front or the back, for a stature of 1.75 m
_SOONEST = 0.35  # seconds between two events of a kind of one foot
_STRIDE = (0.5, 2.5)  # seconds
_METHOD = (
    "Foot strike: the heel is farthest before the pelvis along the way of walking; foot off: the toe is farthest "
    "behind it (Zeni et al. 2008). Contact is from one to the other. Seconds, metres, m/s; cadence in steps per "
    "minute; stance and double support as shares of a stride."
)


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
        """Summarise the strides: mean and standard deviation of each figure, and the cadence; empty without any."""
        if not self.strides:
            return {}
        rows = [asdict(stride) for stride in self.strides]
        figures = {name: np.array([row[name] for row in rows]) for name in rows[0] if name not in ("foot", "start")}
        figures = {name: values[np.isfinite(values)] for name, values in figures.items()}
        means = {
            name: {"mean": float(values.mean()), "sd": float(values.std(ddof=1)) if len(values) > 1 else None}
            for name, values in figures.items()
            if len(values)
        }
        return {"strides": len(rows), "cadence": 120 / means["duration"]["mean"], **means}


def gait(motion: Motion) -> Gait:
    """Find the strides of somebody who walks over level ground, in a motion whose world is y up or z up."""
    nobody = Gait((), (), {"left": [], "right": []})
    names = ("pelvis", *(f"{side}_{point}" for side in "lr" for point in ("heel", "toe")))
    count = int((motion.timestamps[-1] - motion.timestamps[0]) * _RATE) + 1
    if count < _STRIDE[0] * _RATE or not set(names) <= set(motion.joint_names):
        return nobody
    times = motion.timestamps[0] + np.arange(count) / _RATE
    level = [axis for axis in range(3) if axis != "xyz".index(motion.up)]
    places = motion.joints[:, [motion.joint_names.index(name) for name in names]].astype(np.float64)[..., level]
    even = np.stack([[np.interp(times, motion.timestamps, one) for one in row.T] for row in places.swapaxes(0, 1)])
    pelvis, *feet = sosfiltfilt(butter(2, _CUT, fs=_RATE, output="sos"), even, axis=-1).swapaxes(1, 2)
    velocity = gaussian_filter1d(np.gradient(pelvis, 1 / _RATE, axis=0), _AHEAD * _RATE, axis=0, mode="nearest")
    speed = np.linalg.norm(velocity, axis=1)
    way, walks = velocity / np.maximum(speed, 1e-9)[:, None], speed > _SLOWEST
    reach = _REACH * float(stature(motion.character)) / 1.75
    found: dict[tuple[str, str], np.ndarray] = {}
    heels: dict[str, np.ndarray] = {}
    for number, foot in enumerate(("left", "right")):
        heels[foot], toe = feet[2 * number], feet[2 * number + 1]
        for kind, ahead in (
            ("strike", ((heels[foot] - pelvis) * way).sum(1)),
            ("off", -((toe - pelvis) * way).sum(1)),
        ):
            found[foot, kind] = _peaks(ahead, walks, reach)
    strides, contact, holes = [], {"left": [], "right": []}, _holes(motion.timestamps)
    for foot, other in (("left", "right"), ("right", "left")):
        strikes, offs = found[foot, "strike"], found[foot, "off"]
        for start, end in zip(strikes, [*strikes, np.inf][1:], strict=True):
            between = offs[(offs > start) & (offs < end)]
            if len(between) != 1 or between[0] - start > _STRIDE[1] * _RATE:
                continue
            last = end if np.isfinite(end) else between[0]
            if ((holes[:, 0] < _time(times, last)) & (holes[:, 1] > _time(times, start))).any():
                continue  # nobody knows how the feet went
            contact[foot].append((_time(times, start), _time(times, between[0])))
            if np.isfinite(end) and _STRIDE[0] <= (end - start) / _RATE <= _STRIDE[1]:
                opposite = [found[other, kind] for kind in ("strike", "off")]
                strides.append(_stride(foot, start, between[0], end, times, way, heels[foot], heels[other], opposite))
    events = [_event(motion, foot, kind, _time(times, at)) for (foot, kind), all_ in found.items() for at in all_]
    ordered = (sorted(events, key=lambda one: one.seconds), sorted(strides, key=lambda one: one.start))
    return Gait(tuple(ordered[0]), tuple(ordered[1]), contact) if strides else nobody


def write_gait(motion: Motion, path: Path, form: ExportForm) -> None:
    """Write events, strides, contact and a summary as JSON; a sentence says it where nobody walks."""
    found = gait(motion)
    if not found.strides:
        form.say(f"{form.name}: no stride was found, so the figures are empty; they are of somebody who walks.")
    write_json(
        path,
        {
            "method": _METHOD,
            "summary": found.summary(),
            "strides": [asdict(one) for one in found.strides],
            "events": [asdict(one) for one in found.events],
            "contact": found.contact,
        },
    )


def _holes(times: Float[np.ndarray, " frame"]) -> Float[np.ndarray, "hole 2"]:
    """Find where frames are missing: seconds of the frames before and after."""
    apart = np.diff(times)
    missing = np.flatnonzero(apart > 1.75 * np.median(apart))
    return np.stack([times[missing], times[missing + 1]], axis=1)


def _peaks(ahead: Float[np.ndarray, " sample"], walks: np.ndarray, reach: float) -> Float[np.ndarray, " peak"]:
    """Find the peaks of a distance while somebody walks, in samples and parts of one."""
    at, _ = find_peaks(ahead, prominence=reach, distance=_SOONEST * _RATE)
    at = at[walks[at]]
    before, here, after = (ahead[at + step] for step in (-1, 0, 1))
    return at + 0.5 * (before - after) / np.minimum(before - 2 * here + after, -1e-12)


def _stride(
    foot: str,
    start: float,
    off: float,
    end: float,
    times: np.ndarray,
    way: np.ndarray,
    heel: np.ndarray,
    other: np.ndarray,
    opposite: list[np.ndarray],
) -> Stride:
    first, last = round(start), min(round(end), len(times) - 1)
    along = way[last]
    across = np.array([-along[1], along[0]])
    duration = (end - start) / _RATE
    length = float(np.linalg.norm(heel[last] - heel[first]))
    apart = heel[last] - other[last]
    strikes, offs = (one[(one > start) & (one < end)] for one in opposite)
    both = np.nan
    if len(strikes) == 1 and len(offs) == 1 and offs[0] < strikes[0] < off:
        both = float((offs[0] - start + off - strikes[0]) / (end - start))
    return Stride(
        foot,
        _time(times, start),
        float(duration),
        length,
        float(length / duration),
        float(apart @ along),
        float(abs(apart @ across)),
        float((off - start) / (end - start)),
        both,
    )


def _event(motion: Motion, foot: str, kind: str, seconds: float) -> GaitEvent:
    frame = int(np.abs(motion.timestamps - seconds).argmin())
    points = [motion.joint_names.index(f"{foot[0]}_{point}") for point in ("heel", "toe")]
    confidence = float(motion.confidence[frame, points].min())
    return GaitEvent(foot, kind, seconds, int(motion.frames[frame]), confidence, bool(motion.trusted[frame]))


def _time(times: np.ndarray, sample: float) -> float:
    return float(times[0] + sample / _RATE)
