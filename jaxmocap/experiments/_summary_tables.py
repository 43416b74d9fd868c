"""What the rows say: tables of medians with their spread, and paired differences, as text for HTML and Markdown."""

from collections.abc import Sequence
from typing import NamedTuple

from ._statistics import Difference, Summary, compare, summary
from ._table import Row


class Table(NamedTuple):
    """A caption, the head of the columns, and rows of text."""

    caption: str
    head: tuple[str, ...]
    body: list[tuple[str, ...]]


def tables_of(rows: Sequence[Row]) -> list[Table]:
    """The comparison first, then a table per experiment, in the order of the rows."""
    names = list(dict.fromkeys(row["experiment"] for row in rows))
    tables = []
    for name in names:
        members = [row for row in rows if row["experiment"] == name]
        if name == "comparison":
            tables += [_errors(members), _margins(members)]
        else:
            tables.append(_factor(name, members))
    return tables


def _errors(rows: Sequence[Row]) -> Table:
    """Method by capture."""
    captures, methods = _in_order(rows, "capture"), _in_order(rows, "value")
    body = []
    for method in methods:
        cells = [_text(_of(rows, method, capture)) for capture in captures]
        cells.append(_text(summary(row.get("marker_error_cm") for row in rows if row["value"] == method)))
        seconds = summary(row.get("seconds_per_frame") for row in rows if row["value"] == method)
        body.append((method, *cells, f"{seconds.median:.1f}"))
    caption = "Marker error in cm: median over the seeds (quartiles in brackets where there are several runs)"
    return Table(caption, ("method", *captures, "all", "s per frame"), body)


def _margins(rows: Sequence[Row]) -> Table:
    """How far ours is ahead, paired."""
    ours = [row for row in rows if row["value"] == "ours"]
    body = []
    for method in _in_order(rows, "value"):
        if method != "ours":
            theirs = [row for row in rows if row["value"] == method]
            body.append((method, *_difference(compare(ours, theirs, "marker_error_cm"))))
    caption = "How much larger the marker error is than ours: paired by capture and seed, 95 % bootstrap interval"
    return Table(caption, ("method", "pairs", "median cm", "interval", "verdict"), body)


def _factor(name: str, rows: Sequence[Row]) -> Table:
    """A value by row, per capture; the difference from the first value of the same capture."""
    body = []
    several = len(_in_order(rows, "capture")) > 1 and len(_in_order(rows, "value")) == 1
    for capture in [None] if several else _in_order(rows, "capture"):
        members = [row for row in rows if capture is None or row["capture"] == capture]
        values = _in_order(members, "value")
        first = [row for row in members if row["value"] == values[0]]
        for value in values:
            theirs = [row for row in members if row["value"] == value]
            found = summary(row.get("marker_error_cm") for row in theirs)
            worst = summary(row.get("marker_error_max_cm") for row in theirs)
            failed = sum(row["status"] != "done" for row in theirs)
            gap = found.median - summary(row.get("marker_error_cm") for row in first).median
            change = "" if value == values[0] or not found.count else f"{gap:+.2f}"
            note = f"{failed} failed" if failed else ""
            body.append((capture or "", value, _text(found), f"{worst.median:.2f}", change, note))
    head = ("capture", rows[0]["factor"], "marker error cm", "worst frame cm", "change", "")
    return Table(name, head, body)


def _in_order(rows: Sequence[Row], column: str) -> list[str]:
    return list(dict.fromkeys(row[column] for row in rows))


def _of(rows: Sequence[Row], value: str, capture: str) -> Summary:
    return summary(row.get("marker_error_cm") for row in rows if row["value"] == value and row["capture"] == capture)


def _text(found: Summary) -> str:
    if not found.count:
        return "failed"
    return f"{found.median:.2f}" + (f" [{found.low:.2f}, {found.high:.2f}]" if found.count > 1 else "")


def _difference(found: Difference) -> tuple[str, str, str, str]:
    if not found.pairs:
        return "0", "", "", "no pairs"
    interval = "" if found.pairs < 2 else f"[{found.low:+.2f}, {found.high:+.2f}]"
    verdict = "not sure" if not found.sure else ("ours is better" if found.low > 0 else "ours is worse")
    return str(found.pairs), f"{found.median:+.2f}", interval, verdict
