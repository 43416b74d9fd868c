"""Videos in, a motion out: every stage from the first on that is not done yet, or whose inputs have changed."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from jaxmocap._types import Quality
from jaxmocap.motion import Motion

from ._run_files import fetch_weights
from ._run_folder import only_run
from ._run_inputs import examine_in
from ._run_options import RunOptions
from ._run_plan import PlannedStage, done_before, given_by_hand, plan_of
from ._run_record import RunRecord
from ._run_stages import do_stage, in_a_run, stages_of
from ._run_work import RunWork


@dataclass(frozen=True)
class RunResult:
    """What a run ends with.

    Attributes:
        motion: of the person.
        capture: folder of the capture, with what every stage made.
        folder: of the result.
        report: the page to look at first.
        seconds: of the stages that were done in this run, by name.
    """

    motion: Motion
    capture: Path
    folder: Path
    report: Path
    seconds: dict[str, float]


def run(
    videos: str | Path | Sequence[str | Path],
    out: str | Path,
    *,
    height: float | None = None,
    camera_distance: float | None = None,
    focal: Mapping[str, float] | None = None,
    offset: Mapping[str, float] | None = None,
    frames: tuple[int, int | None] = (0, None),
    quality: Quality = "normal",
    actor: str | Path | None = None,
    scan: str | Path | None = None,
    person: Mapping[str, tuple[float, float]] | None = None,
    weights: str | Path | None = None,
    keypoints: str | Path | None = None,
    static: bool = False,
    detections: bool = True,
    seed: int = 0,
    plan: Callable[[list[PlannedStage]], None] = lambda planned: None,
    say: Callable[[str], None] = lambda sentence: None,
    progress: Callable[[str, int, int], None] = lambda stage, done, total: None,
) -> RunResult:
    """Make a motion of videos: synchronise, find the person, calibrate, make a body to measure, track, report.

    `out` is a new folder, or that of an earlier run of the same videos, which goes on from the first stage whose inputs
    changed. What the stages make lies in `out/capture`, an ordinary capture folder: correct it there, and run again. A
    line of its `capture.toml` that was changed by hand is never overwritten. Results lie in `out/result`, later ones in
    `out/result-2` and so on.

    `height` is the person's, `camera_distance` that of the first two cameras at their first shared frame, both in
    metres; one of them, or an `actor` (a scan or a character), tells the scale. `focal` lengths in pixels, by camera,
    are kept. `offset` are seconds to add to a camera's own time, by camera, 0 for those it leaves out; with it nothing
    is synchronised. `scan` is a video once around the person, who stands still, pictures from all around, or what
    `scan` kept of either, of which the actor is made; without a `height` it is as tall as several videos show the
    person by the `camera_distance`, and what `scan` kept is as large as it was made. `frames` (A, B) are A to B - 1 of
    the shared ones; None is the end. `person` are pixels on the person in the first picture that all videos share, by
    camera; `weights` a detector's networks; `keypoints` a folder of another detector's files; `static` says that all
    cameras stand still, whatever the background says. With `detections` keypoints count beside the pixels while
    tracking. With one video the camera is taken to stand still and level.

    `plan` is told first what will be done, `say` what is assumed. Raises `InputError` for what cannot be used, before
    anything is done where that can be known, else naming the stage; what the stages before it made stays.
    """
    options = RunOptions(
        height=height,
        camera_distance=camera_distance,
        focal=dict(focal or {}),
        offset=dict(offset or {}),
        frames=frames,
        quality=quality,
        actor=_path(actor),
        scan=_path(scan),
        person=dict(person or {}),
        weights=_path(weights),
        keypoints=_path(keypoints),
        static=static,
        detections=detections,
        seed=seed,
    )
    out = Path(out)
    RunRecord(out)  # raises where no run may write

    def tell(sentence: str) -> None:
        say(in_a_run(sentence, work))

    indices, options = examine_in(out, [videos] if isinstance(videos, str | Path) else videos, options)
    took: dict[str, float] = {}
    with only_run(out, out):
        work = RunWork(indices, out, options, RunRecord(out), tell, progress)
        work.forget_deleted()
        planned = plan_of(work)
        plan(planned)
        fetch_weights(options, [stage.name for stage in planned if stage.state == "to do"], tell)
        for stage in stages_of(work):
            if given_by_hand(work, stage):
                say(f"{stage.name}: {stage.line} was set by hand in capture.toml, and stays.")
            elif not done_before(work, stage):
                begin = time.perf_counter()
                made = do_stage(work, stage)
                took[stage.name] = time.perf_counter() - begin
                work.record.set(stage.name, stage.inputs(), made, took[stage.name])
            if stage.name == "synchronise":
                work.refuse_frames_not_shared()
        folder, motion, page = work.result()
    return RunResult(motion, work.folder, folder, page, took)


def _path(path: str | Path | None) -> Path | None:
    return None if path is None else Path(path)
