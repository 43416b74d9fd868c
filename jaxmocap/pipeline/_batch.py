"""Many takes, each brought to its result once, whatever happens to the others or to the process."""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from jaxmocap._files import is_clutter, write_csv, write_json, write_text
from jaxmocap._results import InputError
from jaxmocap._types import Quality

from ._batch_page import batch_headline, batch_page
from ._run_folder import LOCK, finished, only_run
from ._take import Take, TakeOptions
from ._take_list import examine_takes, takes_of
from ._take_result import TakeResult, attempt, failed, waiting
from ._workers import on_workers

RECORD, TABLE, INDEX = "batch.json", "batch.csv", "index.html"
_COLUMNS = (
    "name", "way", "verdict", "frames", "trusted_frames", "doubtful_frames", "lost_frames", "marker_error_cm",
    "joint_error_cm", "seconds", "seconds_per_frame", "report",
)  # fmt: skip


@dataclass(frozen=True)
class Batch:
    """What a batch ends with.

    Attributes:
        takes: what came of each, in the order in which they were given.
        folder: of the batch, with a folder per take.
        index: the page to look at first.
    """

    takes: tuple[TakeResult, ...]
    folder: Path
    index: Path

    @property
    def failed(self) -> tuple[TakeResult, ...]:
        """Takes without a result."""
        return tuple(take for take in self.takes if take.way == "failed")

    @property
    def headline(self) -> str:
        """One sentence of how the takes turned out."""
        return batch_headline(self.takes)


def batch(
    takes: Sequence[str | Path],
    out: str | Path,
    *,
    quality: Quality = "normal",
    seed: int = 0,
    frames: tuple[int, int | None] = (0, None),
    settings: Mapping[str, Any] | None = None,
    actor: str | Path | None = None,
    height: float | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    say: Callable[[str], None] = lambda sentence: None,
    progress: Callable[[str, int, int], None] = lambda stage, done, total: None,
) -> Batch:
    """Track many takes, of one person or of several; `out/NAME` is the result folder of each.

    `takes` are capture folders, tracked as `track_capture` does, and `.toml` files that list takes: `[[take]]` sections
    with a `capture`, or with a `name` and `videos`, of which a motion is made as `run` does, and with `frames`,
    `height` and `actor` of their own. `frames` (A, B) are A to B - 1, None is the end; `height` is in metres. These,
    the preset `quality`, `seed`, `settings` and the file of an `actor` hold for every take that says nothing else.

    The same call goes on after an interruption: a take that has its result of the same inputs is not tracked again, one
    that was cut off goes on from its checkpoint, to the same bytes, and one that failed is tried again. A take that
    fails stops no other. `workers` processes share the takes, or a Dask cluster whose `scheduler` is named, as
    `on_workers` says; all machines must then see the folders, and the program that calls this needs the usual
    `if __name__ == "__main__":`. `out/batch.json`, `batch.csv` and the page `index.html` are written after every take;
    they keep the takes of earlier calls whose folders are there.

    Raises `InputError` where anything that is given cannot be used, before a take is tracked.
    """
    out = Path(out).resolve()
    actor = None if actor is None else Path(actor).resolve()
    options = TakeOptions(quality, seed, frames, settings or {}, actor, height)
    todo = takes_of([Path(path) for path in takes], options)
    _refuse_folder(out, [take.name for take in todo])
    examine_takes(todo, out)
    shared = on_workers(partial(attempt, out=out), todo, failed, workers, scheduler)
    with only_run(out, out):
        earlier = _earlier(out)
        results = {take.name: _until_its_turn(take, earlier.pop(take.name, None)) for take in todo} | earlier
        _write(list(results.values()), out)
        progress("takes", 0, len(todo))
        try:
            for done, result in enumerate(shared, 1):
                results[result.name] = result
                _write(list(results.values()), out)
                say(f"{result.name} ({result.way}): {result.verdict}")
                progress("takes", done, len(todo))
        except KeyboardInterrupt:
            say(f"What is done is kept in {out}; the same again goes on from there.")
            raise
    return Batch(tuple(results[take.name] for take in todo), out, out / INDEX)


def _refuse_folder(out: Path, names: Sequence[str]) -> None:
    taken = next((name for name in names if name in (RECORD, TABLE, INDEX, LOCK)), None)
    if taken is not None:
        raise InputError(
            f"a take is called '{taken}', as a file of the batch is; give it another name in a takes.toml."
        )
    if out.exists() and not out.is_dir():
        raise InputError(f"the output {out} is a file; a folder was expected, choose another with --out.")
    if out.is_dir() and not (out / RECORD).is_file() and not all(is_clutter(entry.name) for entry in out.iterdir()):
        raise InputError(f"{out} holds files that no batch wrote; choose a new or an empty folder with --out.")


def _earlier(out: Path) -> dict[str, TakeResult]:
    """Read the rows of earlier calls whose takes have a folder; none of a record that is missing or damaged."""
    try:
        record = json.loads((out / RECORD).read_text(encoding="utf-8"))
        rows = TypeAdapter(list[TakeResult]).validate_python(record["takes"])
        return {row.name: row for row in rows if (out / row.name).is_dir()}
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return {}


def _until_its_turn(take: Take, earlier: TakeResult | None) -> TakeResult:
    """Keep what an earlier call said of a take that has its result; any other waits."""
    if earlier is not None and earlier.folder is not None and finished(earlier.folder):
        return earlier
    return waiting(take)


def _write(takes: Sequence[TakeResult], out: Path) -> None:
    write_json(out / RECORD, {"headline": batch_headline(takes), "takes": [asdict(take) for take in takes]})
    write_csv(out / TABLE, _COLUMNS, ([getattr(take, column) for column in _COLUMNS] for take in takes))
    write_text(out / INDEX, batch_page(takes, out))
