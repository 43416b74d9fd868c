"""Many runs: each is done once, whatever happens to the others or to the process."""

import json
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from jaxmocap._cache import code_hash
from jaxmocap._files import write_json, write_text
from jaxmocap._results import InputError
from jaxmocap._types import Report
from jaxmocap.baselines import BUILT_IN, METHODS
from jaxmocap.pipeline import Failure, check_workers, on_workers

from ._perform import check_runs, perform
from ._run import Run

RUNS, CAPTURES, MOTIONS = "runs", "captures", "motions"
_CODE = "code.txt"


def sweep(
    runs: Iterable[Run],
    out: str | Path,
    *,
    captures: str | Path | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    retry_failed: bool = False,
    progress: Report | None = None,
) -> list[dict[str, Any]]:
    """Do all runs, equal ones once; their records in order.

    A finished run is `out/runs/<key>.json`, written atomically with its motion in `out/motions`, and is never done
    again: a sweep that was killed goes on where it stopped. A run that fails is recorded with its error and does not
    stop the rest; `retry_failed` does those again. Synthetic captures are kept in `captures` (default `out/captures`).

    `workers` processes share the runs, or a Dask cluster whose `scheduler` is named, as `on_workers` says; `out` must
    then be a folder that all of them see. Methods that were added to `jaxmocap.baselines.METHODS` are sent to them.

    Raises `InputError` when `out` holds runs of other code: figures of two versions are never mixed. With nothing
    written it is raised where Dask is needed and not installed, and for a run that names a method, a preset, a setting
    or a capture that does not exist.
    """
    out = Path(out)
    check_workers(workers, scheduler)
    runs = list(runs)
    check_runs(runs)
    _refuse_other_code(out)
    captures = out / CAPTURES if captures is None else Path(captures)
    for folder in (out / RUNS, out / MOTIONS, captures):
        folder.mkdir(parents=True, exist_ok=True)
    todo = {run.key: run for run in runs}
    known = {key: read_record(out, key) for key in todo}
    again = ("failed",) if retry_failed else ()
    open_runs = [run for key, run in todo.items() if (found := known[key]) is None or found["status"] in again]
    done, total = len(todo) - len(open_runs), len(todo)
    tell = progress or (lambda stage, done, total: None)
    tell("runs", done, total)
    added = {run.method: METHODS[run.method] for run in open_runs if run.method not in BUILT_IN}
    call = partial(attempt, out=out.resolve(), captures=captures.resolve(), methods=added)
    died = partial(_failed, out=out, seconds=float("nan"))
    for record in on_workers(call, _by_capture(open_runs), died, workers, scheduler):
        known[record["key"]] = record
        done += 1
        tell("runs", done, total)
    return [record for record in known.values() if record is not None]


def _refuse_other_code(out: Path) -> None:
    path, code = out / _CODE, code_hash()
    if path.is_file() and path.read_text().strip() != code:
        raise InputError(
            f"{out} holds runs of another version of jaxmocap; choose another folder, so that versions are not mixed."
        )
    out.mkdir(parents=True, exist_ok=True)
    write_text(path, code + "\n")


def read_record(out: Path, key: str) -> dict[str, Any] | None:
    """Read the record of a run that is finished or has failed; None where there is none."""
    path = out / RUNS / f"{key}.json"
    return json.loads(path.read_text()) if path.is_file() else None


def attempt(run: Run, out: Path, captures: Path, methods: Mapping[str, Callable[..., Any]]) -> dict[str, Any]:
    """Do one run and write its record, whatever comes of it. Only interruptions pass through.

    `methods` are those that a user added, of which another process does not know.
    """
    METHODS.update(methods)
    begin = time.perf_counter()
    try:
        record, motion = perform(run, captures)
        motion.save(out / MOTIONS / run.key, overwrite=True)
    except Exception as error:
        return _failed(run, error, out, time.perf_counter() - begin)
    write_json(out / RUNS / f"{run.key}.json", record)
    return record


def _failed(run: Run, error: BaseException, out: Path, seconds: float) -> dict[str, Any]:
    """Write the record of a run that failed, and return it."""
    record = {
        "key": run.key,
        "status": "failed",
        **{name: value for name, value in run.described().items() if name != "capture"},
        "capture": run.capture_name,
        **Failure.of(error)._asdict(),
        "seconds": seconds,
    }
    write_json(out / RUNS / f"{run.key}.json", record)
    return record


def _by_capture(runs: Sequence[Run]) -> list[Run]:
    """Sort runs so that those that share a registration are beside each other."""
    return sorted(runs, key=lambda run: (run.capture_name, str(run.inputs), run.seed, str(run.appearance)))
