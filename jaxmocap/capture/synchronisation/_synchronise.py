"""Videos that started at different times: the offset of each, by flash, sound and motion."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any, Literal

from jaxmocap._results import InputError

from .._span import shared_frames
from .._video import VideoIndex
from ._estimate import METHODS, Estimate, MethodName, Pair, Undecided, agreeing, choose, solve_offsets
from ._flash import Brightness, Flash, compare_flashes, find_flashes, measure_brightness
from ._motion import MotionCurve, compare_motions, measure_motion
from ._sound import Sound, compare_sounds, read_sound

Progress = Callable[[str, int, int], None]
SyncMethod = Literal["auto", "flash", "sound", "motion"]
Span = tuple[int, int | None]
"""Frames of each video, from 0: the first, and the one behind the last, None for the end."""

_FEW_FRAMES = 1800  # of all videos; flow is slow, so that long ones are compared by motion only where it is needed


class Evidence:
    """Brightness, flashes, sound and motion of several videos, by camera number.

    Raises `Undecided` for what a video does not have, and `InputError` where one cannot be decoded.
    """

    def __init__(self, videos: Sequence[VideoIndex], progress: Progress | None = None, span: Span = (0, None)):
        self.videos = tuple(videos)
        self._span = span
        self._progress = progress
        self._kept: dict[tuple[str, int], Any] = {}

    def estimate(self, method: MethodName, first: int, second: int) -> Estimate:
        """Ask one method about two videos."""
        if method == "sound":
            return compare_sounds(*self._both(self.sound, first, second))
        one, other = self._both(self.brightness, first, second)
        if method == "flash":
            return compare_flashes(one, other, self.flashes(first), self.flashes(second))
        return compare_motions(self.motion(first), self.motion(second))

    def brightness(self, camera: int) -> Brightness:
        def measure() -> Brightness:
            found = measure_brightness(self.videos[camera], self._tell("brightness", camera))
            if found.complaint is not None:
                raise Undecided(found.complaint)
            return found

        return self._once("brightness", camera, measure)

    def flashes(self, camera: int) -> list[Flash]:
        start, stop = self._frames(camera)

        def inside() -> list[Flash]:
            return [flash for flash in find_flashes(self.brightness(camera)) if start <= flash.frame < stop]

        return self._once("flashes", camera, inside)

    def sound(self, camera: int) -> Sound:
        return self._once("sound", camera, lambda: read_sound(self.videos[camera]).between(*self._seconds(camera)))

    def motion(self, camera: int) -> MotionCurve:
        lit = [flash.frame for flash in self.flashes(camera)]
        tell = self._tell("motion", camera)

        def measure() -> MotionCurve:
            return measure_motion(self.videos[camera], lit, tell).between(*self._seconds(camera))

        return self._once("motion", camera, measure)

    def _frames(self, camera: int) -> tuple[int, int]:
        """Return the first frame that counts, and the one behind the last."""
        count = self.videos[camera].num_frames
        return self._span[0], count if self._span[1] is None else min(self._span[1], count)

    def _seconds(self, camera: int) -> tuple[float, float]:
        """From when to when a video counts, since its first frame; all of it where all frames do."""
        start, stop = self._frames(camera)
        seconds = self.videos[camera].seconds
        return (
            -math.inf if start == 0 else float(seconds[start]),
            math.inf if stop == len(seconds) else float(seconds[stop]),
        )

    def _once(self, what: str, camera: int, measure: Callable[[], Any]) -> Any:
        key = (what, camera)
        if key not in self._kept:
            try:
                self._kept[key] = measure()
            except Undecided as undecided:
                self._kept[key] = undecided
        if isinstance(self._kept[key], Undecided):
            raise Undecided(str(self._kept[key]))
        return self._kept[key]

    def _both(self, of: Callable[[int], Any], first: int, second: int) -> tuple[Any, Any]:
        """Of two cameras; if neither has it, the reason names both."""
        missing = []
        for camera in (first, second):
            try:
                of(camera)
            except Undecided as undecided:
                missing.append(str(undecided))
        if missing:
            raise Undecided(" and ".join(missing))
        return of(first), of(second)

    def _tell(self, what: str, camera: int) -> Callable[[float], None]:
        """Progress in whole seconds of the video."""
        video, report = self.videos[camera], self._progress
        stage, total = f"{what} of {video.path.name}", int(video.seconds[-1])
        return lambda done: None if report is None else report(stage, int(done), total)


@dataclass(frozen=True)
class Synchronisation:
    """When the videos of several cameras started.

    Attributes:
        cameras: their names.
        offsets: one per camera, seconds added to its video's own time to give the first camera's.
        frame: the first camera's time between frames, seconds.
        method: what was asked for.
        pairs: what is known about every two cameras.
        notes: sentences about what is doubtful.
    """

    cameras: tuple[str, ...]
    offsets: tuple[float, ...]
    frame: float
    method: SyncMethod
    pairs: tuple[Pair, ...]
    notes: tuple[str, ...]

    def record(self) -> dict[str, Any]:
        """Return all of it as `sync.json` holds it."""
        return {
            "method": self.method,
            "cameras": {
                name: self._both_units(offset) for name, offset in zip(self.cameras, self.offsets, strict=True)
            },
            "pairs": [self._pair(pair) for pair in self.pairs],
            "notes": list(self.notes),
        }

    def _both_units(self, offset: float) -> dict[str, Any]:
        frames = offset / self.frame
        return {"offset_seconds": round(offset, 6), "offset_frames": round(frames, 3), "whole_frames": round(frames)}

    def _pair(self, pair: Pair) -> dict[str, Any]:
        def one(estimate: Estimate) -> dict[str, Any]:
            figures = {"confidence": round(estimate.confidence, 4), "at_seconds": round(estimate.when, 3)}
            return {**self._both_units(estimate.offset), **figures, **estimate.detail}

        return {
            "cameras": [self.cameras[pair.first], self.cameras[pair.second]],
            "used": None if pair.chosen is None else pair.chosen.method,
            "estimates": {method: one(estimate) for method, estimate in pair.estimates.items()},
            "undecided": dict(pair.reasons),
        }


def synchronise(
    videos: Sequence[VideoIndex],
    names: Sequence[str],
    method: SyncMethod = "auto",
    progress: Progress | None = None,
    span: Span = (0, None),
) -> Synchronisation:
    """Find when videos started. "auto" asks flash, sound and motion and holds them against each other.

    Only the frames of a `span` of each video count, from the first to before the second, None for the last.
    Estimates agree within half a frame of the slower video. Of those that do not, the largest group that agrees is
    used, else flash before sound before motion, and a note says so. Raises `InputError` where nothing can decide.
    """
    if len(videos) < 2:
        raise InputError("there is one video; two or more are needed to synchronise them")
    if any(video.num_frames < 2 for video in videos):
        short = next(video.path for video in videos if video.num_frames < 2)
        raise InputError(f"video {short} has one frame; nothing can be synchronised with it")
    for video in videos:
        if not 0 <= span[0] < (video.num_frames if span[1] is None else span[1]) - 1 or span[0] > video.num_frames - 2:
            stop = "" if span[1] is None else span[1]
            raise InputError(
                f"frames {span[0]}:{stop} are to count, but video {video.path} has {video.num_frames}; two or more of "
                "each video are needed"
            )
    evidence, frame = Evidence(videos, progress, span), videos[0].interval
    pairs = []
    for first, second in combinations(range(len(videos)), 2):
        tolerance = 0.5 * max(videos[first].interval, videos[second].interval)
        estimates, reasons = _ask(evidence, first, second, method, tolerance)
        both = (names[first], names[second])
        pairs.append(choose((first, second), both, estimates, reasons, tolerance, frame))
    offsets, open_loops = solve_offsets(pairs, names, 0.5 * max(video.interval for video in videos), frame)
    try:
        shared_frames(videos, offsets)
    except InputError as error:
        raise InputError(f"{error}; nothing was changed") from error
    notes = (*(note for pair in pairs for note in pair.notes), *open_loops)
    return Synchronisation(tuple(names), tuple(offsets), frame, method, tuple(pairs), notes)


def _ask(
    evidence: Evidence, first: int, second: int, method: SyncMethod, tolerance: float
) -> tuple[dict[MethodName, Estimate], dict[MethodName, str]]:
    """Ask the methods wanted about two videos: what they say, and why the others do not."""
    estimates: dict[MethodName, Estimate] = {}
    reasons: dict[MethodName, str] = {}
    few = sum(video.num_frames for video in evidence.videos) <= _FEW_FRAMES
    for one in METHODS:
        if method not in ("auto", one):
            continue
        if one == "motion" and method == "auto" and not few and len(agreeing(estimates, tolerance)) == 2:
            reasons[one] = "it was not asked, for flash and sound agree"
            continue
        try:
            estimates[one] = evidence.estimate(one, first, second)
        except Undecided as undecided:
            reasons[one] = str(undecided)
    return estimates, reasons
