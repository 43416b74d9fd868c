"""Public data sets as captures. Nothing is downloaded: a reader says what to get and on which terms."""

from collections.abc import Callable
from pathlib import Path
from typing import Protocol

from jaxmocap._results import InputError

from ._biocv import BioCV as BioCV
from ._humaneva import HUMANEVA_1, HUMANEVA_2, HumanEva as HumanEva, read_calibration as read_calibration
from ._movi import MoVi as MoVi
from ._opencap import OpenCap as OpenCap
from ._sequence import (
    RecordedCamera as RecordedCamera,
    RecordedSequence as RecordedSequence,
    StaticCalibration as StaticCalibration,
    named,
    write_sequence as write_sequence,
)
from ._tnt15 import TNT15 as TNT15


class DatasetReader(Protocol):
    """A reader of one data set.

    Attributes:
        name: of the data set.
        licence: its terms, in words.
        download: where to get it, and what.
    """

    name: str
    licence: str
    download: str

    def sequences(self, folder: Path) -> list[str]:
        """List the sequences in a folder."""
        ...

    def read(self, folder: Path, sequence: str, cameras: tuple[str, ...] | None = None) -> RecordedSequence:
        """Read one of them, from the data set's default cameras or from `cameras`."""
        ...


DATASETS: dict[str, DatasetReader] = {
    "humaneva-1": HUMANEVA_1,
    "humaneva-2": HUMANEVA_2,
    "tnt15": TNT15(),
    "biocv": BioCV(),
    "movi": MoVi(),
    "opencap": OpenCap(),
}


def import_dataset(
    dataset: str,
    folder: str | Path,
    out: str | Path,
    *,
    sequence: str | None = None,
    cameras: tuple[str, ...] | None = None,
    frames: tuple[int, int] | None = None,
    say: Callable[[str], None] | None = None,
) -> Path:
    """Make a capture of one sequence of a data set that lies in `folder`; return `out`.

    `dataset` is "humaneva-1", "humaneva-2", "tnt15", "biocv", "movi" or "opencap"; `sequence` such as "S1/Walking_1"
    may be left out where there is only one; `cameras` replace the default ones; `frames` (start, stop) takes a part.
    `say` is told what to know about the data. The capture still needs keypoints at a selected frame and, but for TNT15,
    an actor. Raises `InputError` for anything that is missing or cannot be.
    """
    if dataset not in DATASETS:
        raise InputError(f"there is no reader for '{dataset}'; choose one of {', '.join(DATASETS)}.")
    reader, folder = DATASETS[dataset], Path(folder)
    found = reader.sequences(folder) if folder.is_dir() else []
    if not found:
        raise InputError(
            f"{folder} holds no sequence of {reader.name}. Get it from {reader.download}. Licence: {reader.licence}."
        )
    recorded = reader.read(folder, named(found, sequence, folder), cameras)
    made = write_sequence(recorded, Path(out), frames)
    if say is not None and recorded.note:
        say(recorded.note)
    return made
