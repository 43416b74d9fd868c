"""What each way of synchronising says about two videos, which of them to believe, and one offset per camera."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import Any, Literal

from jaxmocap._results import InputError

MethodName = Literal["flash", "sound", "motion"]
METHODS: tuple[MethodName, ...] = ("flash", "sound", "motion")
"""In the order in which they are believed when they disagree."""
SURE = 0.3
"""Confidence below which an estimate counts less than any other."""


@dataclass(frozen=True)
class Estimate:
    """What one method says about two videos, whose times count from their first frames.

    Attributes:
        method: flash, sound or motion.
        offset: seconds added to the second video's time to give the first's.
        confidence: in [0, 1]; what it is made of, the method says.
        when: time of the second video at which the offset holds, seconds.
        drift: seconds per second by which the offset grows, where the clocks differ; None: not known.
        detail: for the report.
    """

    method: MethodName
    offset: float
    confidence: float
    when: float
    drift: float | None = None
    detail: Mapping[str, Any] = field(default_factory=dict)

    def at(self, when: float) -> float:
        """Compute the offset at another time of the second video, seconds."""
        return self.offset + (self.drift or 0.0) * (when - self.when)


class Undecided(Exception):
    """A method cannot decide; the message is a clause that says why, and names the video where one is to blame."""


@dataclass(frozen=True)
class Pair:
    """What is known about two cameras.

    Attributes:
        first: number of the one camera.
        second: number of the other.
        estimates: what each method says.
        reasons: why the other methods cannot.
        chosen: the estimate that is used; None: nothing could be decided.
        notes: sentences about what is doubtful.
        confirmed: whether another method agrees with the chosen one.
    """

    first: int
    second: int
    estimates: Mapping[MethodName, Estimate]
    reasons: Mapping[MethodName, str]
    chosen: Estimate | None
    notes: tuple[str, ...]
    confirmed: bool = False


def apart(one: Estimate, other: Estimate) -> float:
    """Measure the seconds between two estimates, at a time for which both hold."""
    when = other.when if one.drift is not None else one.when
    return abs(one.at(when) - other.at(when))


def agreeing(estimates: Mapping[MethodName, Estimate], tolerance: float) -> list[Estimate]:
    """Find the largest group of estimates of which any two are within `tolerance` seconds, the one to use first.

    Of groups of one size it is the one whose first is believed most, unsure ones last. Empty if there is no estimate.
    """
    ordered = [estimates[method] for method in METHODS if method in estimates]
    ordered.sort(key=lambda one: one.confidence < SURE)
    for size in range(len(ordered), 0, -1):
        for group in combinations(ordered, size):
            if all(apart(one, other) <= tolerance for one, other in combinations(group, 2)):
                return list(group)
    return []


def choose(
    cameras: tuple[int, int],
    names: tuple[str, str],
    estimates: Mapping[MethodName, Estimate],
    reasons: Mapping[MethodName, str],
    tolerance: float,
    frame: float,
) -> Pair:
    """Choose the estimate of a pair. `frame` is the time between frames, seconds, in which notes speak.

    Where sound knows how the clocks drift and agrees, an estimate that holds at one moment (a flash) is moved to the
    middle of the span that both videos share.
    """
    group = agreeing(estimates, tolerance)
    if not group:
        return Pair(*cameras, estimates, reasons, None, ())
    chosen, notes, between = group[0], [], f"{names[0]} and {names[1]}"
    sound = next((one for one in group if one.drift is not None), None)
    if sound is not None and chosen.drift is None:
        moved = chosen.offset + sound.offset - sound.at(chosen.when)
        chosen = replace(chosen, offset=moved, when=sound.when, drift=sound.drift)
    others = [one for one in estimates.values() if apart(group[0], one) > tolerance]
    if others:
        said = " and ".join(f"{one.offset / frame:+.2f} by {one.method}" for one in others)
        backing = "".join(f", and {one.method} agrees" for one in group[1:])
        notes.append(
            f"{between}: the offset in frames is {group[0].offset / frame:+.2f} by {chosen.method}{backing}, but it is "
            f"{said}: {chosen.method} is used; choose another with --method"
        )
    if sound is not None and sound.drift is not None:
        drifted = abs(sound.drift) * float(sound.detail["shared_seconds"])
        if drifted > frame:
            notes.append(
                f"{between}: their clocks drift apart by {drifted / frame:.1f} frames while both run; the offset holds "
                "in the middle: cut the videos into shorter captures"
            )
    return Pair(*cameras, estimates, reasons, chosen, tuple(notes), confirmed=len(group) > 1)


def solve_offsets(
    pairs: Sequence[Pair], names: Sequence[str], tolerance: float, frame: float
) -> tuple[list[float], list[str]]:
    """Solve for offsets in seconds, 0 for the first camera, along the surest pairs.

    Returns with them a sentence for each that is tied weakly and for each pair that does not close within `tolerance`.

    Raises `InputError` naming a camera that no pair ties to the first.
    """
    known = {0: 0.0}
    used: list[Pair] = []
    while len(known) < len(names):
        ties = [p for p in pairs if p.chosen is not None and (p.first in known) != (p.second in known)]
        if not ties:
            raise InputError(_cannot(pairs, names, next(c for c in range(len(names)) if c not in known)))
        tie = max(ties, key=_certainty)
        offset = _chosen(tie).offset
        if tie.first in known:
            known[tie.second] = known[tie.first] + offset
        else:
            known[tie.first] = known[tie.second] - offset
        used.append(tie)
    notes = [sentence for pair in used for sentence in _weakness(pair, names)]
    for pair in pairs:
        if pair.chosen is None or any(pair is one for one in used):
            continue
        error = pair.chosen.offset - (known[pair.second] - known[pair.first])
        if abs(error) > tolerance:
            notes.append(
                f"{names[pair.first]} and {names[pair.second]} by {pair.chosen.method} do not fit the surer pairs: "
                f"{error / frame:+.2f} frames remain; look whether they show the same moment"
            )
    return [known[camera] for camera in range(len(names))], notes


def _chosen(pair: Pair) -> Estimate:
    assert pair.chosen is not None
    return pair.chosen


def _certainty(pair: Pair) -> tuple[bool, bool, int, float]:
    """Rank a pair: confirmed by another method first, then by belief in the method, then by confidence."""
    chosen = _chosen(pair)
    return pair.confirmed, chosen.confidence >= SURE, -METHODS.index(chosen.method), chosen.confidence


def _weakness(pair: Pair, names: Sequence[str]) -> list[str]:
    chosen = _chosen(pair)
    if pair.confirmed or (chosen.method != "motion" and chosen.confidence >= SURE):
        return []
    why = (
        "which is good to about a frame"
        if chosen.method == "motion"
        else f"with a confidence of only {chosen.confidence:.2f}"
    )
    return [
        f"{names[pair.first]} and {names[pair.second]}: {chosen.method} alone decided, {why}; look whether they show "
        "the same moment"
    ]


def _cannot(pairs: Sequence[Pair], names: Sequence[str], camera: int) -> str:
    pair = next(p for p in pairs if camera in (p.first, p.second))
    first, second = names[pair.first], names[pair.second]
    reasons = "; ".join(f"by {method}, {reason}" for method, reason in pair.reasons.items())
    return (
        f"{second} cannot be synchronised with {first}: {reasons}; nothing was changed: film a flash or a clap that "
        "all cameras record, or write offset = SECONDS into capture.toml by hand"
    )
