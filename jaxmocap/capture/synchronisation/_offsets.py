"""From what is known about pairs of videos to one offset per camera."""

from collections.abc import Sequence

from jaxmocap._results import InputError

from ._choose import Pair
from ._estimate import METHODS, SURE, Estimate


def solve_offsets(
    pairs: Sequence[Pair], names: Sequence[str], tolerance: float, frame: float
) -> tuple[list[float], list[str]]:
    """Offsets in seconds, 0 for the first camera, along the surest pairs; and a sentence for each that is tied weakly
    and for each pair that does not close within `tolerance`.

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
    """Confirmed by another method first, then by how much the method is believed, then by its confidence."""
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
