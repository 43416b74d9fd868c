"""Spatio-temporal figures of gait: foot strikes, foot offs, strides, cadence, contact."""

from dataclasses import asdict
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.ndimage import gaussian_filter1d
from scipy.signal import butter, find_peaks, sosfiltfilt

from jaxmocap._files import write_json
from jaxmocap.character import stature
from jaxmocap.motion import Motion

from ._exporter import ExportForm
from ._gait_record import Gait, GaitEvent, Stride

_POINTS = ("pelvis", "l_heel", "l_toe", "r_heel", "r_toe")
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
    "minute; stance and double support as shares of a stride. Standard deviations of a stride are those of the heels' "
    "places; those of the summary are between strides, of which those that are not trusted are left out."
)


class _Walk(NamedTuple):
    """A motion as gait is found in it, `_RATE` samples per second, on the two level axes."""

    motion: Motion
    times: Float[np.ndarray, " sample"]
    level: list[int]
    way: Float[np.ndarray, "sample 2"]
    heels: dict[str, Float[np.ndarray, "sample 2"]]

    def seconds(self, sample: float) -> float:
        """Return the motion's time at a sample."""
        return float(self.times[0] + sample / _RATE)


def gait(motion: Motion) -> Gait:
    """Find the strides of somebody who walks over level ground, in a motion whose world is y up or z up."""
    nobody = Gait((), (), {"left": [], "right": []})
    count = int((motion.timestamps[-1] - motion.timestamps[0]) * _RATE) + 1
    if count < _STRIDE[0] * _RATE or not set(_POINTS) <= set(motion.joint_names):
        return nobody
    times = motion.timestamps[0] + np.arange(count) / _RATE
    level = [axis for axis in range(3) if axis != "xyz".index(motion.up)]
    places = motion.joints[:, [motion.joint_names.index(name) for name in _POINTS]].astype(np.float64)[..., level]
    even = np.stack([[np.interp(times, motion.timestamps, one) for one in row.T] for row in places.swapaxes(0, 1)])
    pelvis, *feet = sosfiltfilt(butter(2, _CUT, fs=_RATE, output="sos"), even, axis=-1).swapaxes(1, 2)
    velocity = gaussian_filter1d(np.gradient(pelvis, 1 / _RATE, axis=0), _AHEAD * _RATE, axis=0, mode="nearest")
    speed = np.linalg.norm(velocity, axis=1)
    way, walks = velocity / np.maximum(speed, 1e-9)[:, None], speed > _SLOWEST
    reach = _REACH * float(stature(motion.character)) / 1.75
    walk = _Walk(motion, times, level, way, {"left": feet[0], "right": feet[2]})
    found: dict[tuple[str, str], np.ndarray] = {}
    for foot, toe in (("left", feet[1]), ("right", feet[3])):
        for kind, ahead in (
            ("strike", ((walk.heels[foot] - pelvis) * way).sum(1)),
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
            if ((holes[:, 0] < walk.seconds(last)) & (holes[:, 1] > walk.seconds(start))).any():
                continue  # nobody knows how the feet went
            contact[foot].append((walk.seconds(start), walk.seconds(between[0])))
            if np.isfinite(end) and _STRIDE[0] <= (end - start) / _RATE <= _STRIDE[1]:
                opposite = [found[other, kind] for kind in ("strike", "off")]
                strides.append(_stride(walk, foot, start, between[0], end, opposite))
    events = [_event(motion, foot, kind, walk.seconds(at)) for (foot, kind), all_ in found.items() for at in all_]
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


def _stride(walk: _Walk, foot: str, start: float, off: float, end: float, opposite: list[np.ndarray]) -> Stride:
    other = "right" if foot == "left" else "left"
    first, last = round(start), min(round(end), len(walk.times) - 1)
    heel, along = walk.heels[foot], walk.way[last]
    across = np.array([-along[1], along[0]])
    duration, gone = (end - start) / _RATE, heel[last] - heel[first]
    length, apart = float(np.linalg.norm(gone)), heel[last] - walk.heels[other][last]
    strikes, offs = (one[(one > start) & (one < end)] for one in opposite)
    both = np.nan
    if len(strikes) == 1 and len(offs) == 1 and offs[0] < strikes[0] < off:
        both = float((offs[0] - start + off - strikes[0]) / (end - start))
    begins, ends = (_covariance(walk, foot, sample) for sample in (start, end))
    step = ends + _covariance(walk, other, end)
    return Stride(
        foot,
        walk.seconds(start),
        float(duration),
        length,
        float(length / duration),
        float(apart @ along),
        float(abs(apart @ across)),
        float((off - start) / (end - start)),
        both,
        _deviation(begins + ends, gone / max(length, 1e-9)),
        _deviation(step, along),
        _deviation(step, across),
        *_trust(walk.motion, walk.seconds(start), walk.seconds(end)),
    )


def _covariance(walk: _Walk, foot: str, sample: float) -> Float[np.ndarray, "2 2"]:
    """Find how uncertain a heel's place over the ground is, square metres; NaN where that is not known."""
    motion = walk.motion
    if motion.covariance is None:
        return np.full((2, 2), np.nan)
    frame = int(np.abs(motion.timestamps - walk.seconds(sample)).argmin())
    heel = motion.joint_names.index(f"{foot[0]}_heel")
    return motion.covariance[frame, heel][np.ix_(walk.level, walk.level)].astype(np.float64)


def _deviation(covariance: Float[np.ndarray, "2 2"], way: Float[np.ndarray, "2"]) -> float:
    return float(np.sqrt(np.maximum(way @ covariance @ way, 0.0)))


def _trust(motion: Motion, start: float, end: float) -> tuple[float, bool]:
    """Return the least confidence over the frames of a stride, and whether these are to be trusted."""
    times = motion.timestamps
    frames = slice(max(int(np.searchsorted(times, start, "right")) - 1, 0), int(np.searchsorted(times, end)) + 1)
    points = [motion.joint_names.index(name) for name in _POINTS]
    known = motion.confidence[frames]
    lost = (known[:, points] <= 0).any(axis=1) & known.any(axis=1)  # where no confidence is known, all are 0
    return float(known[:, points].min()), bool((motion.status[frames] == "ok").all() and not lost.any())


def _event(motion: Motion, foot: str, kind: str, seconds: float) -> GaitEvent:
    frame = int(np.abs(motion.timestamps - seconds).argmin())
    points = [motion.joint_names.index(f"{foot[0]}_{point}") for point in ("heel", "toe")]
    confidence = float(motion.confidence[frame, points].min())
    return GaitEvent(foot, kind, seconds, int(motion.frames[frame]), confidence, bool(motion.trusted[frame]))
