"""What came of a take: one row of a batch's table, its JSON and its page."""

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from jaxmocap.metrics import evaluate
from jaxmocap.motion import Motion
from jaxmocap.viewers import REPORT_PAGE, findings, headline

from ._take import Take, Tracked, Way
from ._workers import Failure


@dataclass(frozen=True)
class TakeResult:
    """One take of a batch.

    Attributes:
        name: of the take.
        source: the capture folder, or the videos.
        way: how it got its result: "tracked", "resumed" where an earlier batch was cut off, "kept" where one had
            finished it; "failed", or "waiting" while the batch is at work.
        verdict: how far the result may be trusted, in one sentence; of a failed take what went wrong.
        frames: how many there are; of these:
        trusted_frames: those to be trusted, all limbs.
        doubtful_frames: those that may be wrong.
        lost_frames: those in which the person was not found.
        findings: what to know before the result is used, such as doubtful spans and why, in sentences.
        marker_error_cm: mean, where the capture has a truth with markers.
        joint_error_cm: mean, where the capture has a truth with joints.
        seconds: that the take took in this batch.
        seconds_per_frame: that tracking took, whenever it was.
        notes: what was assumed or found doubtful on the way.
        folder: of the result.
        report: its page.
        traceback: where the take failed by an error of ours, which please report.
    """

    name: str
    source: tuple[Path, ...]
    way: Way | Literal["waiting", "failed"]
    verdict: str
    frames: int = 0
    trusted_frames: int = 0
    doubtful_frames: int = 0
    lost_frames: int = 0
    findings: tuple[str, ...] = ()
    marker_error_cm: float | None = None
    joint_error_cm: float | None = None
    seconds: float | None = None
    seconds_per_frame: float | None = None
    notes: tuple[str, ...] = ()
    folder: Path | None = None
    report: Path | None = None
    traceback: str | None = None

    @property
    def trusted(self) -> bool:
        """Whether the take has a result, and every frame of it is to be trusted."""
        return self.frames > 0 and self.trusted_frames == self.frames


def waiting(take: Take) -> TakeResult:
    """Say that a take's turn has not come."""
    return TakeResult(take.name, take.source, "waiting", "Not tracked yet.")


def failed(take: Take, error: BaseException, seconds: float | None = None, notes: tuple[str, ...] = ()) -> TakeResult:
    """Say why a take has no result."""
    why, trace = Failure.of(error)
    return TakeResult(take.name, take.source, "failed", why, seconds=seconds, notes=notes, traceback=trace)


def attempt(take: Take, out: Path) -> TakeResult:
    """Bring a take to its result in `out`, or say why it has none. Only interruptions pass through."""
    begin, notes = time.perf_counter(), list[str]()
    try:
        tracked = take.track(out / take.name, lambda said: notes.append(said.replace(" with --resume", "")))
        return _result(take, tracked, begin, notes)
    except Exception as error:
        return failed(take, error, time.perf_counter() - begin, tuple(notes))


def _result(take: Take, tracked: Tracked, begin: float, notes: list[str]) -> TakeResult:
    motion = tracked.motion
    markers, joints = _errors(motion, notes)
    return TakeResult(
        take.name,
        take.source,
        tracked.way,
        headline(motion),
        frames=len(motion),
        trusted_frames=int(motion.trusted.sum()),
        doubtful_frames=int((motion.status == "doubtful").sum()),
        lost_frames=int((motion.status == "lost").sum()),
        findings=tuple(finding["text"] for finding in findings(motion) if finding["kind"] != "note"),
        marker_error_cm=markers,
        joint_error_cm=joints,
        seconds=time.perf_counter() - begin,
        seconds_per_frame=motion.provenance.get("seconds_per_frame"),
        notes=tuple(notes),
        folder=tracked.folder,
        report=tracked.folder / REPORT_PAGE,
    )


def _errors(motion: Motion, notes: list[str]) -> tuple[float | None, float | None]:
    """Compare markers and joints with the truth where the capture has one.

    Whatever goes wrong is a note: the take has its result all the same.
    """
    truth = motion.provenance.get("truth")
    try:
        found = {} if truth is None else evaluate(motion, truth)
    except Exception as error:
        notes.append(f"Not compared with the truth: {Failure.of(error).error}")
        found = {}
    markers, joints = (found.get(name, {}).get("mean") for name in ("marker_error_cm", "joint_error_cm"))
    return markers, joints
