"""What a run will do and about how long it takes, before it begins."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

from ._run_folder import finished
from ._run_stages import Stage, stages_of, written
from ._run_work import TRACKED_LIKE, RunWork

State = Literal["to do", "again", "done", "given"]

_PER_PICTURE = {"synchronise": 0.05, "detect": 0.15, "calibrate": 0.5}
_ONCE = {"capture": 1.0, "calibrate": 20.0, "body": 120.0, "selected frames": 2.0, "track": 90.0}
_SCAN = 300.0
_PER_TRACKED = {"draft": 1.0, "normal": 2.0, "paper": 20.0}
"""Seconds, measured on two cores with pictures of 960 x 540."""


@dataclass(frozen=True)
class PlannedStage:
    """What comes of one stage.

    Attributes:
        name: of the stage.
        what: it does.
        state: "done" before of the same inputs, "given" by hand in `capture.toml`, "to do", or "again" since something
            it is made of has changed.
        seconds: it takes, roughly.
    """

    name: str
    what: str
    state: State
    seconds: float

    def __str__(self) -> str:
        time = f"about {_spoken(self.seconds)}" if self.state in ("to do", "again") else ""
        return f"{self.name}: {', '.join(part for part in (self.what, self.state, time) if part)}"


def plan_of(work: RunWork) -> list[PlannedStage]:
    """Say what will come of every stage.

    Behind the first that has to be done, all that are not given are taken to be done.
    """
    return [PlannedStage(stage.name, stage.what, state, _estimate(work, stage)) for stage, state in _states(work)]


def _states(work: RunWork) -> Iterator[tuple[Stage, State]]:
    changed = False
    for stage in stages_of(work):
        if given_by_hand(work, stage):
            yield stage, "given"
            continue
        if changed or not done_before(work, stage):
            changed = True
            yield stage, "again" if work.record.begun(stage.name) else "to do"
        else:
            yield stage, "done"


def given_by_hand(work: RunWork, stage: Stage) -> bool:
    """Tell whether `capture.toml` says something else in the stage's line than the stage wrote.

    If so, the user's word counts.
    """
    found = written(work, stage)
    return found is not None and found != work.record.made(stage.name)


def done_before(work: RunWork, stage: Stage) -> bool:
    """Tell whether the stage was done of what it would be made of now, and what it wrote is there.

    What `capture.toml` names is there: `forget_deleted` has taken out the rest.
    """
    if not work.folder.is_dir() or not work.record.begun(stage.name):
        return False
    if stage.line is not None and written(work, stage) is None:
        return False
    if stage.name == "track" and not finished(work.out / str(work.record.made("track"))):
        return False
    return work.record.done(stage.name, stage.inputs())


def _estimate(work: RunWork, stage: Stage) -> float:
    before = work.record.seconds(stage.name)
    if before is not None and (stage.name != "track" or work.record.done(TRACKED_LIKE, work.tracked_like())):
        return before
    counts = [index.num_frames for index in work.indices]
    tracked, _ = work.tracked_like()
    seconds = _ONCE.get(stage.name, 0.0) + _PER_PICTURE.get(stage.name, 0.0) * sum(counts)
    if stage.name == "calibrate" and not work.several:
        return 1.0
    if stage.name == "body" and work.options.actor is not None:
        return 5.0
    if stage.name == "body" and work.options.scan is not None:
        return _SCAN if work.options.body_first else _SCAN + seconds
    return seconds + (tracked * len(counts) * _PER_TRACKED[work.options.quality] if stage.name == "track" else 0.0)


def _spoken(seconds: float) -> str:
    if seconds < 90:
        return f"{max(round(seconds), 1)} s"
    return f"{round(seconds / 60)} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"
