"""`jaxmocap bench`: experiments by name, their table, figures and report."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from jaxmocap._results import InputError
from jaxmocap._types import Quality
from jaxmocap.baselines import METHODS

from ._gate import Figure, complaints, figures_of, read_baseline, write_figures
from ._paper import comparison, paper
from ._report import write_report
from ._run import Inputs, Run, Trial
from ._suite import CaptureSpec, film
from ._sweep import CAPTURES, Report, sweep
from ._tables import Row, rows_of, write_frames, write_table

_PICTURED = 12


@dataclass(frozen=True)
class Benchmark:
    """What `bench` found.

    Attributes:
        rows: the tidy table, a row per trial.
        figures: what the gate compares.
        complaints: sentences about figures that are worse than the baseline.
        files: what was written, by what it holds.
    """

    rows: list[Row]
    figures: list[Figure]
    complaints: list[str]
    files: dict[str, Path]

    @property
    def failed(self) -> list[Row]:
        """Runs that failed, each once."""
        return list({row["key"]: row for row in self.rows if row["status"] != "done"}.values())


def bench(
    what: Literal["paper"],
    out: str | Path,
    *,
    quick: bool = False,
    captures: Sequence[str | Path] = (),
    methods: Sequence[str] | None = None,
    frames: tuple[int, int] | None = None,
    quality: Quality | None = None,
    seeds: Sequence[int] | None = None,
    only: str | None = None,
    gate: str | Path | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    retry_failed: bool = False,
    progress: Report | None = None,
) -> Benchmark:
    """Run the paper's section 5: competitors and ablations on captures with known truth, as one table and one report.

    `out` receives `runs.csv` (and `runs.parquet` where pyarrow is installed), `frames.csv`, `figures.json`,
    `report.html` and `report.md`; finished runs stay in `out/runs` and are never done again, so that the same call goes
    on after an interruption. `quick` is one seed on captures of six frames with the preset "draft", ablations on and
    off.

    With `captures`, folders with a truth, only the comparison is done, on these and not on the synthetic suite, in
    `frames` (start, stop); `quick` is then one seed and the preset "draft". `methods` are names of
    `jaxmocap.baselines.METHODS`, `quality` is the preset. `only` is a regular expression for experiments. `gate` is the
    `figures.json` of an earlier run to be held against. `workers`, `scheduler` and `retry_failed` as in `sweep`. Raises
    `InputError` for anything unknown.
    """
    if what != "paper":
        raise InputError(f"there is no benchmark '{what}'; choose paper.")
    unknown = sorted(set(methods or ()) - set(METHODS))
    if unknown:
        raise InputError(f"there is no method '{unknown[0]}'; choose of {', '.join(METHODS)}.")
    out = Path(out)
    if out.exists() and not out.is_dir():
        raise InputError(f"the output {out} is a file; a folder was expected, choose another with --out.")
    trials = _trials(quick, captures, methods, frames, quality, seeds)
    if only is not None:
        trials = _matching(trials, only)
    presets = sorted({trial.run.quality for trial in trials})
    about = {"quick": quick, "quality": ", ".join(presets)}
    if gate is not None:
        read_baseline(Path(gate), **about)  # raises before hours of work, not behind them
    records = sweep(
        [trial.run for trial in trials],
        out,
        workers=workers,
        scheduler=scheduler,
        retry_failed=retry_failed,
        progress=progress,
    )
    rows = rows_of(trials, records)
    figures = figures_of(rows)
    files = {"table": write_table(rows, out / "runs.csv"), "frames": write_frames(rows, out / "frames.csv")}
    if _has_pyarrow():
        files["parquet"] = write_table(rows, out / "runs.parquet")
    files["figures"] = out / "figures.json"
    write_figures(figures, files["figures"], **about)
    frames_each = "" if captures else "six frames per capture, "
    small = f"Quick: {frames_each}one seed, preset {about['quality']}. Not for conclusions."
    notes = [small] if quick else []
    files["report"], files["markdown"] = write_report(rows, out, _folders(trials, out), "Evaluation", notes)
    worse = [] if gate is None else complaints(figures, Path(gate), **about)
    return Benchmark(rows, figures, worse, files)


def _trials(
    quick: bool,
    captures: Sequence[str | Path],
    methods: Sequence[str] | None,
    frames: tuple[int, int] | None,
    quality: Quality | None,
    seeds: Sequence[int] | None,
) -> list[Trial]:
    if captures:
        return _on_folders([Path(folder) for folder in captures], quick, methods, frames, quality, seeds)
    if frames is not None:
        raise InputError("frames were given, but the synthetic suite has its own; give captures too.")
    return [trial for trial in paper(quick, seeds, quality) if methods is None or trial.run.method in methods]


def _on_folders(
    folders: list[Path],
    quick: bool,
    methods: Sequence[str] | None,
    frames: tuple[int, int] | None,
    quality: Quality | None,
    seeds: Sequence[int] | None,
) -> list[Trial]:
    from jaxmocap.capture import Capture, config_path

    folders, by_name = [config_path(folder).parent for folder in folders], dict[str, Path]()
    for folder in folders:
        name = Run(str(folder)).capture_name
        if name.casefold() in by_name:
            raise InputError(
                f"two captures are called '{name}' ({by_name[name.casefold()]} and {folder}); give every capture once, "
                "and rename one of two folders of the same name."
            )
        by_name[name.casefold()] = folder
    trials = []
    for folder in folders:
        capture = Capture.open(folder)
        if capture.truth is None:
            raise InputError(f"capture '{capture.name}' has no truth to compare with; name one in capture.toml.")
        base = Run(
            str(folder),
            quality=quality or ("draft" if quick else "normal"),
            inputs=Inputs(selected=()),
            frames=frames,
        )
        trials += comparison([str(folder)], seeds or ((0,) if quick else (0, 1, 2)), base, tuple(methods or METHODS))
    return trials


def _matching(trials: list[Trial], only: str) -> list[Trial]:
    try:
        found = [trial for trial in trials if re.search(only, trial.experiment)]
    except re.error as error:
        raise InputError(f"--only is {only!r}, which is no regular expression ({error}).") from None
    if not found:
        names = ", ".join(dict.fromkeys(trial.experiment for trial in trials))
        raise InputError(f"no experiment matches {only!r}; there are {names}.")
    return found


def _folders(trials: Sequence[Trial], out: Path) -> dict[str, Path]:
    """Find the captures of the comparison, for pictures."""
    found: dict[str, Path] = {}
    for trial in trials:
        capture = trial.run.capture
        if trial.experiment == "comparison" and len(found) < _PICTURED and trial.run.capture_name not in found:
            is_spec = isinstance(capture, CaptureSpec)
            found[trial.run.capture_name] = film(capture, out / CAPTURES) if is_spec else Path(capture)
    return found


def _has_pyarrow() -> bool:
    from importlib.util import find_spec

    return find_spec("pyarrow") is not None


def summary_lines(result: Benchmark) -> dict[str, Any]:
    """Sum a benchmark up for the command line."""
    runs = {row["key"] for row in result.rows}
    return {
        "runs": len(runs),
        "failed_runs": len(result.failed),
        "failures": {row["key"]: row.get("error") for row in result.failed},
        "complaints": result.complaints,
        "files": {name: str(path) for name, path in result.files.items()},
    }
