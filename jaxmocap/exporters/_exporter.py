"""What every exporter is: a function that writes a motion, and what its format asks for."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NamedTuple, get_args

from jaxmocap.motion import Motion

Units = Literal["m", "cm", "mm"]
Up = Literal["y", "z"]
PER_METRE: dict[str, float] = {"m": 1.0, "cm": 100.0, "mm": 1000.0}
UNITS: tuple[str, ...] = get_args(Units)


def _silent(sentence: str) -> None:
    pass


@dataclass(frozen=True)
class ExportForm:
    """How the file `name` is to be: lengths in `units`, the vertical axis `up`, `frame_rate` frames per second (None
    where the time between frames varies). `actor` is the character's own file, where one is named; `say` is told
    what the user should know."""

    name: str
    units: Units = "m"
    up: Up = "y"
    frame_rate: float | None = None
    actor: Path | None = None
    say: Callable[[str], None] = _silent

    @property
    def per_metre(self) -> float:
        """What lengths in metres are multiplied by."""
        return PER_METRE[self.units]


class Exporter(NamedTuple):
    """`write(motion, path, form)` writes one file, or a folder where `folder` is true, at a path that is free.

    The motion comes with the vertical axis and the frame rate of the form and with joint angles that do not jump; only
    its lengths are still metres. `units` and `up` are what the format is written in where the user does not say (an
    `up` of None leaves the motion's); `fixed` formats define both. `even` ones need the same time between all frames;
    `resamples` is false where frames must stay those of the videos.
    """

    write: Callable[[Motion, Path, ExportForm], None]
    units: Units = "m"
    up: Up | None = None
    fixed: bool = False
    even: bool = False
    resamples: bool = True
    folder: bool = False
