"""A sequence that is being tracked, on disk: enough to go on after a kill to the same bits."""

import contextlib
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from jaxmocap._cache import Stand, UnreadableRecord, different, read_records, write_records
from jaxmocap._results import InputError
from jaxmocap.observation import FrameImages, FrameProblem, Observations
from jaxmocap.verdict import FrameResult

from ._state import TrackingState

FORMAT = 6
_STATE = "state.npz"


class Saved(NamedTuple):
    """What a checkpoint holds.

    Attributes:
        results: by frame.
        leg: 0 forwards, 1 backwards.
        frame: the last one tracked in it.
        state: of the tracking after that frame.
        sizes: of the compiled programs.
    """

    results: dict[int, FrameResult]
    leg: int
    frame: int
    state: TrackingState
    sizes: dict[str, Any]


class Checkpoint:
    """Files of an unfinished run in `folder` (host).

    `state.npz` names the others and is replaced at once, so that a kill at any moment leaves a whole checkpoint, the
    last one or the one before. Results are appended, and what a frame's problem holds is written once. Writing takes at
    most `share` of the time: where frames are quick, not every one is followed by a checkpoint. `inputs` say what is
    tracked and how; a checkpoint of other inputs is refused.
    """

    def __init__(self, folder: str | Path, inputs: Mapping[str, Any] | None = None, share: float = 0.02):
        self.folder = Path(folder)
        self.inputs = dict(inputs or {})
        self.share = share
        self._chunks: list[str] = []
        self._problems: dict[str, FrameProblem] = {}
        self._written: dict[int, FrameResult] = {}
        self._used: set[str] = set()
        self._serial = 0
        self._cost, self._last = 0.0, -float("inf")

    @property
    def exists(self) -> bool:
        """Whether there is something to go on from."""
        return (self.folder / _STATE).is_file()

    def load(self, observations: Observations) -> Saved | None:
        """Load what was kept, None when there is nothing.

        Raises `InputError` when it was made with other inputs, by another version, or is damaged.
        """
        if not self.exists:
            return None
        known, stands = self._context(observations)
        try:
            stored = read_records(self.folder / _STATE, known, stands)
            if stored["format"] != FORMAT:
                raise UnreadableRecord(f"format {stored['format']}")
            self._refuse_others(stored["inputs"])
            results: dict[int, FrameResult] = {}
            for name in stored["chunks"]:
                results |= read_records(self.folder / name)
        except (UnreadableRecord, OSError, KeyError, TypeError) as error:
            raise InputError(
                f"the unfinished run in {self.folder.parent} cannot be continued ({error}); delete {self.folder} and "
                "start again."
            ) from error
        self._chunks, self._serial = list(stored["chunks"]), stored["serial"]
        self._written = dict(results)
        self._clear({_STATE, *self._chunks, *self._problems})
        return Saved(results, stored["leg"], stored["frame"], stored["state"], stored["sizes"])

    def keep(self, saved: Saved, observations: Observations) -> None:
        """Write the state, unless that would cost too much time by now; called after every frame."""
        if time.monotonic() - self._last > self._cost / self.share:
            begin = time.monotonic()
            self.save(saved, observations)
            self._last = time.monotonic()
            self._cost = self._last - begin

    def save(self, saved: Saved, observations: Observations) -> None:
        """Write everything that has changed. Raises `InputError` when the disk does not take it."""
        known, stands = self._context(observations)
        changed = {number: r for number, r in saved.results.items() if self._written.get(number) is not r}
        self._serial += 1
        chunk = f"results-{self._serial:06d}.npz"
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            write_records(self.folder / chunk, changed)
            stored = {"format": FORMAT, "inputs": self.inputs, "chunks": [*self._chunks, chunk]}
            stored |= {"leg": saved.leg, "frame": saved.frame, "serial": self._serial}
            stored |= {"state": saved.state, "sizes": saved.sizes}
            self._used = set()
            write_records(self.folder / _STATE, stored, known, stands)
        except OSError as error:
            raise InputError(
                f"the checkpoint in {self.folder} cannot be written ({error.strerror or error}); make room, and go on "
                "with --resume from the last one."
            ) from error
        self._chunks.append(chunk)
        self._written = dict(saved.results)
        for name in set(self._problems) - self._used:
            del self._problems[name]
            (self.folder / name).unlink(missing_ok=True)

    def remove(self) -> None:
        """Delete the files: the run is finished."""
        self._clear(set())
        with contextlib.suppress(OSError):
            self.folder.rmdir()

    def _clear(self, kept: set[str]) -> None:
        for path in self.folder.glob("*.npz"):
            if path.name not in kept:
                path.unlink(missing_ok=True)

    def _refuse_others(self, inputs: Mapping[str, Any]) -> None:
        others = different(inputs, self.inputs)
        if others:
            raise InputError(
                f"the unfinished run in {self.folder.parent} was begun with another {others}; give the "
                "same again, or choose another folder."
            )

    def _context(self, observations: Observations) -> tuple[dict[str, Any], tuple[Stand, ...]]:
        """Collect what is found again instead of being stored.

        These are tables that all frames share, decoded images, and problems, which have files of their own.
        """
        known = {"surface": observations.surface, "settings": observations.appearance.settings}
        decoded: dict[int, FrameImages] = {}

        def images(note: tuple[int, Any]) -> FrameImages:
            frame, light = note
            if frame not in decoded:
                capture = observations.capture
                views = [capture.image(camera, frame) for camera in range(capture.num_cameras)]
                shown = FrameImages(frame, float(capture.timestamps[frame]), views)
                decoded[frame] = shown if light is None else shown.in_light(light)
            return decoded[frame]

        def written(problem: FrameProblem) -> str:
            name = next((name for name, other in self._problems.items() if other is problem), None)
            if name is None:
                name = f"problem-{self._serial:06d}-{len(self._used)}.npz"
                write_records(self.folder / name, problem, known)
                self._problems[name] = problem
            self._used.add(name)
            return name

        def read(name: str) -> FrameProblem:
            self._problems[name] = read_records(self.folder / name, known)
            return self._problems[name]

        return known, (
            Stand(FrameImages, lambda shown: (shown.frame, shown.light), images),
            Stand(FrameProblem, written, read),
        )
