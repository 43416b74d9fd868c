"""One tidy table: a row per trial, settings and seed beside what came out."""

import csv
import io
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from jaxmocap._files import atomic_path, write_text
from jaxmocap._results import InputError

from ._run import Trial

Row = dict[str, Any]
COLUMNS = (
    "experiment", "factor", "value", "status", "capture", "method", "quality", "seed", "marker_error_cm",
    "marker_error_max_cm", "marker_error_p95_cm", "joint_error_cm", "joint_error_p95_cm", "pa_mpjpe_cm",
    "frames_tracked", "frames_lost", "seconds_per_frame", "seconds_tracking", "seconds", "cpu_seconds", "settings",
    "appearance", "inputs", "frames", "capture_hash", "device", "versions", "error", "key",
)  # fmt: skip


def rows_of(trials: Sequence[Trial], records: Sequence[dict[str, Any]]) -> list[Row]:
    """A row per trial: its experiment, factor and value, and the record of its run."""
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
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    writer.writerows(zip(*columns.values(), strict=True))
    write_text(path, text.getvalue())
    return path


def write_frames(rows: Sequence[Row], path: Path) -> Path:
    """The error of every frame, a row each: run, frame, centimetres."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(("key", "capture", "method", "seed", "frame", "marker_error_cm"))
    for row in {row["key"]: row for row in rows}.values():
        errors = row.get("error_per_frame_cm") or []
        for frame, error in zip(row.get("frame_numbers", [])[: len(errors)], errors, strict=True):
            writer.writerow((row["key"], row["capture"], row["method"], row["seed"], frame, error))
    write_text(path, text.getvalue())
    return path


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
