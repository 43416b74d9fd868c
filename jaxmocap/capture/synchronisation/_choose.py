"""Which of several estimates to believe, and the sentence about those that disagree."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import combinations

from ._estimate import METHODS, SURE, Estimate, MethodName


@dataclass(frozen=True)
class Pair:
    """Two cameras (numbers), what each method says about them or why it cannot, and the estimate that is used (None:
    nothing could be decided). `confirmed`: another method agrees with it."""

    first: int
    second: int
    estimates: Mapping[MethodName, Estimate]
    reasons: Mapping[MethodName, str]
    chosen: Estimate | None
    notes: tuple[str, ...]
    confirmed: bool = False


def apart(one: Estimate, other: Estimate) -> float:
    """Seconds between two estimates, at a time for which both hold."""
    when = other.when if one.drift is not None else one.when
    return abs(one.at(when) - other.at(when))


def agreeing(estimates: Mapping[MethodName, Estimate], tolerance: float) -> list[Estimate]:
    """The largest group of estimates of which any two are within `tolerance` seconds, the one to use first; of groups
    of one size the one whose first is believed most, unsure ones last. Empty if there is no estimate."""
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
    """The pair with its chosen estimate. `frame` is the time between frames, seconds, in which notes speak.

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
