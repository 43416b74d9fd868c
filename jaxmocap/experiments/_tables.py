"""The tidy table, a row per trial with settings and seed beside what came out; and what its rows say: tables of medians
with their spread and of paired differences, as text for HTML and Markdown."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxmocap._files import atomic_path, write_csv
from jaxmocap._results import InputError

from ._run import Trial
from ._statistics import Difference, compare, fewest_pairs, summary

Row = dict[str, Any]
COLUMNS = (
    "experiment", "factor", "value", "status", "capture", "method", "quality", "seed", "marker_error_cm",
    "marker_error_max_cm", "marker_error_p95_cm", "joint_error_cm", "joint_error_p95_cm", "pa_mpjpe_cm",
    "marker_error_by_frame_cm", "marker_error_solved_cm", "joint_error_by_frame_cm", "joint_error_solved_cm",
    "frames_tracked", "frames_lost", "seconds_per_frame", "seconds_tracking", "seconds", "cpu_seconds", "settings",
    "appearance", "inputs", "frames", "capture_hash", "device", "versions", "error", "key",
)  # fmt: skip


class Metric(NamedTuple):
    """An error by which runs are compared, and what tells of the worst: columns, and what they are called."""

    column: str
    name: str
    worst: str
    worst_name: str


MARKERS = Metric("marker_error_cm", "marker error", "marker_error_max_cm", "worst frame cm")
JOINTS = Metric("joint_error_cm", "joint error", "joint_error_p95_cm", "95th percentile cm")


class Table(NamedTuple):
    """A caption, the head of the columns, and rows of text."""

    caption: str
    head: tuple[str, ...]
    body: list[tuple[str, ...]]


def rows_of(trials: Sequence[Trial], records: Sequence[dict[str, Any]]) -> list[Row]:
    """Make a row per trial: its experiment, factor and value, and the record of its run."""
    known = {record["key"]: record for record in records}
    return [
        {"experiment": t.experiment, "factor": t.factor, "value": t.value, **known[t.run.key]}
        for t in trials
        if t.run.key in known
    ]


def write_table(rows: Sequence[Row], path: Path) -> Path:
    """Write `.csv` or `.parquet` (extra `parquet`) with the columns `COLUMNS`; records within a cell are JSON."""
    columns = {name: [_cell(row.get(name)) for row in rows] for name in COLUMNS}
    if path.suffix == ".parquet":
        _write_parquet(columns, path)
        return path
    write_csv(path, COLUMNS, zip(*columns.values(), strict=True))
    return path


def write_frames(rows: Sequence[Row], path: Path) -> Path:
    """Write the error of every frame, a row each: run, frame, centimetres."""
    lines = []
    for row in {row["key"]: row for row in rows}.values():
        errors = row.get("error_per_frame_cm") or []
        for frame, error in zip(row["frame_numbers"] if errors else (), errors, strict=True):
            lines.append((row["key"], row["capture"], row["method"], row["seed"], frame, error))
    write_csv(path, ("key", "capture", "method", "seed", "frame", "marker_error_cm"), lines)
    return path


def metric_of(rows: Sequence[Row]) -> Metric:
    """Choose the metric of a report: markers, or joints where no run has an error of markers."""
    known = lambda metric: any(row.get(metric.column) is not None for row in rows)  # noqa: E731
    return JOINTS if known(JOINTS) and not known(MARKERS) else MARKERS


def tables_of(rows: Sequence[Row]) -> list[Table]:
    """Make the comparison's tables first, then a table per experiment, in the order of the rows."""
    metric = metric_of(rows)
    names = list(dict.fromkeys(row["experiment"] for row in rows))
    tables = []
    for name in names:
        members = [row for row in rows if row["experiment"] == name]
        if name == "comparison":
            tables += [_errors(members, metric), _margins(members, metric), *_alike(members, metric)]
        else:
            tables.append(_factor(name, members, metric))
    return tables


def _cell(value: Any) -> Any:
    return json.dumps(value, sort_keys=True) if isinstance(value, dict | list) else value


def _write_parquet(columns: dict[str, list[Any]], path: Path) -> None:
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        raise InputError(
            "a Parquet table needs pyarrow, which is not installed; run pip install 'jaxmocap[parquet]'."
        ) from None
    with atomic_path(path) as temporary:
        pyarrow.parquet.write_table(pyarrow.table(columns), temporary)


def _errors(rows: Sequence[Row], metric: Metric) -> Table:
    """Tabulate errors, method by capture."""
    captures, methods = _in_order(rows, "capture"), _in_order(rows, "value")
    body = []
    for method in methods:
        members = [row for row in rows if row["value"] == method]
        cells = [_text([row for row in members if row["capture"] == capture], metric) for capture in captures]
        cells.append(_text(members, metric))
        seconds = summary(row.get("seconds_per_frame") for row in members)
        body.append((method, *cells, f"{seconds.median:.1f}"))
    caption = (
        f"{metric.name.capitalize()} in cm: median over the seeds (quartiles in brackets where there are several runs)"
    )
    return Table(caption, ("method", *captures, "all", "s per frame"), body)


def _margins(rows: Sequence[Row], metric: Metric) -> Table:
    """How far ours is ahead, paired."""
    ours = [row for row in rows if row["value"] == "ours"]
    body = []
    for method in _in_order(rows, "value"):
        if method != "ours":
            theirs = [row for row in rows if row["value"] == method]
            body.append((method, *_difference(compare(ours, theirs, metric.column))))
    caption = (
        f"How much larger the {metric.name} is than ours: paired by capture and seed, each capture once, 95 % "
        f"bootstrap interval from {fewest_pairs()} pairs on"
    )
    return Table(caption, ("method", "pairs", "median cm", "interval", "verdict"), body)


def _alike(rows: Sequence[Row], metric: Metric) -> list[Table]:
    """Tabulate every method's poses as it leaves them frame by frame, and solved as a clip, as ours are: then the
    methods differ in what they ask of the pictures. There is no table where no run has both."""
    by_frame, solved = (metric.column.replace("_cm", f"_{name}_cm") for name in ("by_frame", "solved"))
    known = [row for row in rows if row.get(by_frame) is not None and row.get(solved) is not None]
    if not known:
        return []
    ours = [row for row in known if row["value"] == "ours"]
    body = []
    for method in _in_order(known, "value"):
        theirs = [row for row in known if row["value"] == method]
        medians = [f"{summary(row[column] for row in theirs).median:.2f}" for column in (by_frame, solved)]
        ahead = ("",) * 3 if method == "ours" else _difference(compare(ours, theirs, solved))[1:]
        body.append((method, *medians, *ahead))
    caption = (
        f"{metric.name.capitalize()} in cm over all captures, frame by frame and with these poses solved as a clip; "
        "how much larger it is than ours where both are solved"
    )
    return [Table(caption, ("method", "frame by frame", "solved", "median cm", "interval", "verdict"), body)]


def _factor(name: str, rows: Sequence[Row], metric: Metric) -> Table:
    """Tabulate a value by row, per capture, and the difference from the first value of the same capture."""
    body = []
    several = len(_in_order(rows, "capture")) > 1 and len(_in_order(rows, "value")) == 1
    for capture in [None] if several else _in_order(rows, "capture"):
        members = [row for row in rows if capture is None or row["capture"] == capture]
        values = _in_order(members, "value")
        first = [row for row in members if row["value"] == values[0]]
        for value in values:
            theirs = [row for row in members if row["value"] == value]
            found = summary(row.get(metric.column) for row in theirs)
            worst = summary(row.get(metric.worst) for row in theirs)
            failed = sum(row["status"] != "done" for row in theirs)
            gap = found.median - summary(row.get(metric.column) for row in first).median
            change = "" if value == values[0] or not found.count else f"{gap:+.2f}"
            note = f"{failed} failed" if failed else ""
            far = f"{worst.median:.2f}" if worst.count else "–"
            body.append((capture or "", value, _text(theirs, metric), far, change, note))
    head = ("capture", rows[0]["factor"], f"{metric.name} cm", metric.worst_name, "change", "")
    return Table(name, head, body)


def _in_order(rows: Sequence[Row], column: str) -> list[str]:
    return list(dict.fromkeys(row[column] for row in rows))


def _text(rows: Sequence[Row], metric: Metric) -> str:
    found = summary(row.get(metric.column) for row in rows)
    if not found.count:
        return "failed" if any(row["status"] != "done" for row in rows) else "–"
    return f"{found.median:.2f}" + (f" [{found.low:.2f}, {found.high:.2f}]" if found.count > 1 else "")


def _difference(found: Difference) -> tuple[str, str, str, str]:
    if not found.pairs:
        return "0", "", "", "no pairs"
    interval = "" if np.isnan(found.low) else f"[{found.low:+.2f}, {found.high:+.2f}]"
    verdict = "not sure" if not found.sure else ("ours is better" if found.low > 0 else "ours is worse")
    return str(found.pairs), f"{found.median:+.2f}", interval, verdict
