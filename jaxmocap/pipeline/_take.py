"""A take of a batch: a capture folder, tracked as `track` does, or videos, of which `run` makes a motion."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal, NamedTuple

from jaxmocap._results import InputError
from jaxmocap._types import Quality, Say
from jaxmocap.capture import Capture
from jaxmocap.motion import Motion
from jaxmocap.rigging import check_height
from jaxmocap.track import Tracker, with_settings

from ._made_to_measure import refuse_height_beside_actor
from ._run import run
from ._run_folder import finished, refuse_foreign, unfinished
from ._run_inputs import examine_in
from ._run_options import RunOptions, span_within
from ._run_record import RunRecord
from ._track_capture import track_capture

Way = Literal["tracked", "resumed", "kept"]
"""How a take got its result: from the start, from where an earlier batch was cut off, or in an earlier batch."""


class Tracked(NamedTuple):
    """A take that has its result.

    Attributes:
        way: how it got it.
        motion: of the person.
        folder: of the result, with its report page.
    """

    way: Way
    motion: Motion
    folder: Path


@dataclass(frozen=True)
class Take(ABC):
    """One clip of a batch.

    Attributes:
        name: of its folder; no other take of the batch has it.
    """

    name: str

    @property
    @abstractmethod
    def source(self) -> tuple[Path, ...]:
        """The capture folder, or the videos."""

    @abstractmethod
    def examine(self, folder: Path) -> None:
        """Raise `InputError` for what cannot work, as far as that is known before anything is done."""

    @abstractmethod
    def track(self, folder: Path, say: Say) -> Tracked:
        """Bring the take to its result, from wherever it is."""


@dataclass(frozen=True)
class TakeOptions:
    """What takes are told.

    Attributes:
        quality: preset of the tracker.
        seed: of all random numbers.
        frames: (first, behind the last) to track; None for the end.
        settings: of the tracker, by name; not of takes of videos.
        actor: the person's character, instead of a capture's.
        height: of the person, metres, where there is no actor.
    """

    quality: Quality = "normal"
    seed: int = 0
    frames: tuple[int, int | None] = (0, None)
    settings: Mapping[str, Any] = field(default_factory=dict)
    actor: Path | None = None
    height: float | None = None


@dataclass(frozen=True)
class CaptureTake(Take):
    """A capture folder.

    Attributes:
        path: of the capture.
        options: of its tracking.
    """

    path: Path
    options: TakeOptions

    @property
    def source(self) -> tuple[Path, ...]:
        return (self.path,)

    def examine(self, folder: Path) -> None:
        options, capture = self.options, Capture.open(self.path)
        _ = capture.cameras
        span_within(options.frames, capture.num_frames)
        if options.actor is not None and not options.actor.exists():
            raise InputError(f"the actor {options.actor} does not exist")
        refuse_height_beside_actor(capture, options.actor, options.height)
        if options.height is not None:
            check_height(options.height)
        with_settings(Tracker.preset(options.quality), options.settings)
        if not finished(folder):
            refuse_foreign(folder)

    def track(self, folder: Path, say: Say) -> Tracked:
        way: Way = "kept" if finished(folder) else "resumed" if unfinished(folder) else "tracked"
        span = span_within(self.options.frames, Capture.open(self.path).num_frames)
        told: dict[str, Any] = vars(self.options) | {"frames": span}
        return Tracked(way, track_capture(self.path, folder, **told, say=say, resume=True), folder)


@dataclass(frozen=True)
class VideosTake(Take):
    """Videos of the same moment.

    Attributes:
        videos: the files.
        options: of `run`.
    """

    videos: tuple[Path, ...]
    options: RunOptions

    @property
    def source(self) -> tuple[Path, ...]:
        return self.videos

    def examine(self, folder: Path) -> None:
        examine_in(folder, self.videos, self.options)
        RunRecord(folder)

    def track(self, folder: Path, say: Say) -> Tracked:
        begun = RunRecord(folder).begun("capture")
        result = run(self.videos, folder, **asdict(self.options), say=say)
        way: Way = "tracked" if not begun else "resumed" if result.seconds else "kept"
        return Tracked(way, result.motion, result.folder)
