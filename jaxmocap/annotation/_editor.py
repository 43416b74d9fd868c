"""Keypoints under edit: changed one by one, undone and redone, and on disk after every change."""

import shutil
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from jaxmocap._files import free_name, write_text
from jaxmocap._results import InputError
from jaxmocap.capture import Capture, with_keypoints_line
from jaxmocap.detection import BODY_25, VideoKeypoints, best_person, write_body_25

from ._points import MIDDLES

_MARK = "annotated"
_KEPT = ".detected"
_BESIDE = 0.75  # pixels by which a middle may be off and still follow its two points

Points = Float64[np.ndarray, "25 3"]


class Change(NamedTuple):
    """What an edit did to one view."""

    camera: int
    frame: int
    before: Points
    after: Points


@dataclass
class _View:
    points: Points
    people: list[Points]
    on_file: bool


@dataclass
class KeypointEditor:
    """The keypoints of a capture, BODY_25 in pixels of the videos as recorded, frames as the capture counts them.

    Every change is written at once and atomically to `<camera>_<frame>_keypoints.json` in the capture's folder of
    keypoints; without one, the first change makes it and names it in `capture.toml`. A file of that name which was not
    made here is kept beside it, with `.detected` behind its name. A file holds the person that was edited, alone.

    Attributes:
        capture: the capture, opened.
        file: its `capture.toml`.
    """

    capture: Capture
    file: Path
    written: list[Path] = field(default_factory=list)
    _views: dict[tuple[int, int], _View] = field(default_factory=dict)
    _done: list[Change] = field(default_factory=list)
    _undone: list[Change] = field(default_factory=list)
    _lock: threading.RLock = field(default_factory=threading.RLock)

    @property
    def history(self) -> tuple[int, int]:
        """How many changes can be undone and redone."""
        return len(self._done), len(self._undone)

    def points(self, camera: int, frame: int) -> Points:
        """Read the points of one view; confidence 0 where there is none.

        Raises `InputError` for a file that cannot be read.
        """
        with self._lock:
            return self._view(camera, frame).points.copy()

    def num_people(self, camera: int, frame: int) -> int:
        """Count the people that a detector found there."""
        with self._lock:
            return len(self._view(camera, frame).people)

    def set(self, camera: int, frame: int, point: int, place: tuple[float, float] | None) -> None:
        """Set one point, with confidence 1, or take it away.

        Neck and middle of the hips follow shoulders and hips unless they were set themselves.
        """

        def change(points: Points) -> Points:
            moved = points.copy()
            moved[point] = (0.0, 0.0, 0.0) if place is None else (*place, 1.0)
            return _with_middles(points, moved, point)

        self._edit(camera, frame, change)

    def choose(self, camera: int, frame: int, person: int) -> None:
        """Take another of the people that a detector found."""
        self._edit(camera, frame, lambda _: self._view(camera, frame).people[person].copy())

    def undo(self) -> Change | None:
        """Take the last change back; None if there is none."""
        return self._step(self._done, self._undone, lambda change: (change.after, change.before))

    def redo(self) -> Change | None:
        """Make the last change that was taken back again."""
        return self._step(self._undone, self._done, lambda change: (change.before, change.after))

    def _edit(self, camera: int, frame: int, change: Callable[[Points], Points]) -> None:
        with self._lock:
            before = self._view(camera, frame).points
            after = change(before)
            if np.array_equal(before, after):
                return
            self._save(camera, frame, after)
            self._done.append(Change(camera, frame, before, after))
            self._undone.clear()

    def _step(
        self, source: list[Change], target: list[Change], of: Callable[[Change], tuple[Points, Points]]
    ) -> Change | None:
        with self._lock:
            if not source:
                return None
            change = source[-1]
            self._save(change.camera, change.frame, of(change)[1])
            target.append(source.pop())
            return change

    def _view(self, camera: int, frame: int) -> _View:
        if (camera, frame) not in self._views:
            source = self._source(camera)
            own = int(self.capture.video_frames[camera, frame])
            people = [] if source is None else source.people(own)
            best = best_person(people)
            points = np.zeros((25, 3)) if best is None else best
            self._views[camera, frame] = _View(points.copy(), people, source is not None and source.has(own))
        return self._views[camera, frame]

    def _source(self, camera: int) -> VideoKeypoints | None:
        return self.capture.video_keypoints(camera)

    def _save(self, camera: int, frame: int, points: Points) -> None:
        """Write a view and take it over. Raises `InputError`, with nothing changed, if it cannot be written."""
        view = self._view(camera, frame)
        try:
            self._name_folder()
            source = self._source(camera)
            assert source is not None
            file = source.expected_file(int(self.capture.video_frames[camera, frame]))
            kept = file.with_name(file.name + _KEPT)
            if file.is_file() and file not in self.written and not kept.exists() and _MARK not in _start(file):
                shutil.copyfile(file, kept)
            if (points[:, 2] > 0).any() or view.on_file:
                write_body_25(file, points, **{_MARK: True})
            else:
                file.unlink(missing_ok=True)
        except OSError as error:
            raise InputError(f"{error.filename or self.capture.folder} cannot be written: {error.strerror}") from error
        if file not in self.written:
            self.written.append(file)
        view.points = points

    def _name_folder(self) -> None:
        """Make a folder for keypoints and name it in `capture.toml`, if that names none."""
        if self.capture.keypoints_folder is not None:
            return
        folder = free_name(self.file.parent, "keypoints")
        folder.mkdir()
        text = self.file.read_bytes().decode("utf-8")  # not read_text, which would change line ends
        write_text(self.file, with_keypoints_line(text, folder.name, self.file))
        self.capture = self.capture.with_keypoints_folder(folder)


def _with_middles(before: Points, points: Points, changed: int) -> Points:
    """Middles whose two points are there and which nobody set elsewhere, as their mean."""
    for name, pair in MIDDLES.items():
        middle, *ends = (BODY_25.points.index(point) for point in (name, *pair))
        old = before[ends, :2].mean(0)
        followed = before[middle, 2] == 0 or (
            (before[ends, 2] > 0).all() and np.abs(before[middle, :2] - old).max() < _BESIDE
        )
        if changed not in ends or not followed:
            continue
        there = bool((points[ends, 2] > 0).all())
        points[middle] = (*points[ends, :2].mean(0), points[ends, 2].min()) if there else (0.0, 0.0, 0.0)
    return points


def _start(file: Path) -> str:
    with file.open(encoding="utf-8", errors="replace") as text:
        return text.read(200)
