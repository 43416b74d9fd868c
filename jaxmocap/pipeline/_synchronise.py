"""Synchronising a capture: `capture.toml` is completed in place, or made from a list of videos."""

import contextlib
import shutil
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from jaxmocap._files import atomic_folder, atomic_path, write_json, write_text
from jaxmocap._results import InputError
from jaxmocap.capture import SYNC_REPORT, Synchronisation, SyncMethod, SyncPlan, plan_new_capture, plan_sync


def sync(
    capture: str | Path | Sequence[str | Path],
    out: str | Path | None = None,
    *,
    method: SyncMethod = "auto",
    frames: tuple[int, int | None] = (0, None),
    progress: Callable[[str, int, int], None] | None = None,
) -> Synchronisation:
    """Find when each video of a capture started, by a flash, by sound and by motion, and write it down.

    `capture` is a capture folder or its `capture.toml`, in which `offset` of every camera is set, everything else
    staying as it is; with `out` it is a list of videos, which are copied into this new capture folder. `sync.json`
    beside `capture.toml` holds each method's estimate. `method` is "auto", "flash", "sound" or "motion". Only
    `frames` of each video count, from the first to before the second, None for the last.

    Raises `InputError`, with nothing changed on disk, if the videos cannot be read or no method can decide.
    """
    several = not isinstance(capture, str | Path)
    if out is None:
        if several and len(capture) != 1:
            raise InputError(
                f"{len(capture)} paths were given; give one capture folder, or two or more videos and a new folder "
                "with --out"
            )
        plan = plan_sync(capture[0] if several else capture, method, progress, frames)
        _complete(plan)
    else:
        with new_capture(list(capture) if several else [capture], Path(out), method, progress, frames) as (plan, _):
            pass
    return plan.found


@contextlib.contextmanager
def new_capture(
    videos: Sequence[str | Path],
    out: Path,
    method: SyncMethod = "auto",
    progress: Callable[[str, int, int], None] | None = None,
    frames: tuple[int, int | None] = (0, None),
) -> Iterator[tuple[SyncPlan, Path]]:
    """Synchronise videos and copy them into a capture that becomes `out` when the block ends well, and vanishes when it
    raises; what was found, and the folder in which the block may complete it."""
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise InputError(f"{out} exists already; choose a new folder for the capture")
    plan = plan_new_capture(videos, out, method, progress, frames)
    try:
        with atomic_folder(out) as partial:
            for name, video in plan.copies.items():
                shutil.copyfile(video, partial / name)
            write_json(partial / SYNC_REPORT, plan.found.record())
            write_text(partial / plan.file.name, plan.text)
            yield plan, partial
    except OSError as error:
        raise InputError(f"the capture folder {out} cannot be written: {error.strerror}") from error


def _complete(plan: SyncPlan) -> None:
    file = plan.file.resolve()  # a link stays a link
    try:
        with atomic_path(plan.file.parent / SYNC_REPORT) as report:
            write_json(report, plan.found.record())
            write_text(file, plan.text)
    except OSError as error:
        raise InputError(f"{plan.file} cannot be written: {error.strerror}; nothing was changed") from error
