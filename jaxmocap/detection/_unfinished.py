"""What was seen in the first pictures of a video, kept so that a search that is cut off goes on to the same bits."""

import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from jaxmocap._files import npz_bytes, write_bytes

from ._person_model import Sighting
from ._region import Region


@dataclass(frozen=True)
class SeenSoFar:
    """One person in the first pictures of a video.

    Attributes:
        seen: the person in each picture; None where nobody was found.
        since: pictures since the person was found anew.
        notes: sentences on what was chosen.
    """

    seen: Sequence[Sighting | None] = ()
    since: int = 0
    notes: Sequence[str] = ()


def write_seen(file: Path, seen: SeenSoFar, of: str) -> None:
    """Write what was seen, atomically, to be read again where it is of the same, whatever `of` says."""
    found = [one for one in seen.seen if one is not None]
    numbers = [[*one.region.centre, one.region.side, one.region.angle, one.presence, one.doubt] for one in found]
    arrays = {
        "of": np.array(of),
        "found": np.array([one is not None for one in seen.seen], bool),
        "points": np.array([one.points for one in found], np.float64),
        "numbers": np.array(numbers, np.float64),
        "since": np.array(seen.since),
        "notes": np.array([*seen.notes], np.str_),
    }
    write_bytes(file, npz_bytes(arrays))


def read_seen(file: Path, of: str) -> SeenSoFar:
    """Read what `write_seen` wrote; nothing where there is no such file, or it is of something else or damaged."""
    try:
        with np.load(file, allow_pickle=False) as arrays:
            if str(arrays["of"]) != of:
                return SeenSoFar()
            found = iter(zip(arrays["points"], arrays["numbers"].tolist(), strict=True))
            seen = [_sighting(*next(found)) if there else None for there in arrays["found"]]
            return SeenSoFar(seen, int(arrays["since"]), arrays["notes"].tolist())
    except (OSError, ValueError, KeyError, EOFError, StopIteration, zipfile.BadZipFile):
        return SeenSoFar()


def _sighting(points: np.ndarray, numbers: Sequence[float]) -> Sighting:
    x, y, side, angle, presence, doubt = numbers
    return Sighting(points, presence, Region((x, y), side, angle), doubt)
