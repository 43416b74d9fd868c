"""Figures with a direction and a tolerance, held against earlier ones."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

from jaxmocap._atomic import write_json
from jaxmocap._results import InputError

from ._statistics import summary
from ._table import Row

Figure = dict[str, object]
_TOLERANCE, _SLACK = 0.1, 0.15
"""A median error may grow by this share of itself and, small ones, by this many centimetres."""


def figure(
    metric: str, value: float, unit: str, tolerance: float, direction: Literal["lower", "higher"] = "lower"
) -> Figure:
    """One figure: which direction is better, and by how much of itself it may get worse."""
    return {"metric": metric, "value": round(value, 5), "unit": unit, "direction": direction, "tolerance": tolerance}


def worse(figures: Sequence[Figure], baseline: Sequence[Figure]) -> list[str]:
    """Sentences about figures beyond their tolerance."""
    before = {entry["metric"]: float(str(entry["value"])) for entry in baseline}
    found = []
    for one in figures:
        if one["metric"] not in before:
            continue
        now, was = float(str(one["value"])), before[one["metric"]]
        by = now - was if one["direction"] == "lower" else was - now
        if not by <= abs(was) * float(str(one["tolerance"])) + 1e-9:
            found.append(f"{one['metric']}: {now} {one['unit']}, was {was}")
    return found


def figures_of(rows: Sequence[Row]) -> list[Figure]:
    """Medians over the seeds of what ours does in every experiment, and how many runs failed."""
    groups: dict[tuple[str, str, str], list[Row]] = {}
    for row in rows:
        if row["method"] == "ours":
            groups.setdefault((row["experiment"], row["capture"], row["value"]), []).append(row)
    figures = []
    for (experiment, capture, value), members in groups.items():
        found = summary(row.get("marker_error_cm") for row in members)
        if found.count:
            tolerance = _TOLERANCE + _SLACK / max(found.median, 1e-6)
            figures.append(figure(f"{experiment}, {capture}, {value}: marker error", found.median, "cm", tolerance))
    failed = len({row["key"] for row in rows if row["status"] != "done"})
    return [*figures, figure("failed runs", failed, "runs", 0.0)]


def write_figures(figures: Sequence[Figure], path: Path, **about: Any) -> None:
    """As a baseline for `complaints`."""
    write_json(path, {**about, "figures": list(figures)})


def complaints(figures: Sequence[Figure], path: Path, **about: Any) -> list[str]:
    """What is worse than in a baseline file. `InputError` if it cannot be read, is one of other runs (`about`, as in
    `write_figures`), or has no figure in common."""
    try:
        whole = json.loads(path.read_text())
        baseline = whole["figures"]
        known = {entry["metric"] for entry in baseline}
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(
            f"the baseline {path} cannot be read ({error}); give the figures.json of an earlier run."
        ) from None
    for name, value in about.items():
        if whole.get(name, value) != value:
            raise InputError(
                f"the baseline {path} has {name} {whole[name]}, this run {value}; give one of runs like these."
            )
    missing = sorted(known - {str(one["metric"]) for one in figures})
    if len(missing) == len(known):
        raise InputError(f"the baseline {path} is one of other experiments: it has no figure in common with this run.")
    return [*worse(figures, baseline), *(f"{metric}: not measured this time" for metric in missing)]
