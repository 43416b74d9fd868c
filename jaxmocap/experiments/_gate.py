"""Figures with a direction and a tolerance, held against earlier ones."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np

from jaxmocap._files import write_json
from jaxmocap._results import InputError

from ._tables import Row, metric_of

Figure = dict[str, object]
_TOLERANCE = 0.1
"""An error may grow by this share of itself, and by three standard errors."""

_SPREAD = 0.4
"""Centimetres between the errors of two seeds, or of the roundings of two machines, on the quick suite (measured); it
holds where every run has one seed and the baseline knows no better."""

_ENOUGH = 4
"""So many seeds tell the spread of a figure by itself; with fewer it is pooled over all."""


def figure(
    metric: str, value: float, unit: str, tolerance: float, direction: Literal["lower", "higher"] = "lower"
) -> Figure:
    """Make one figure: which direction is better, and by how much of itself it may get worse."""
    return {"metric": metric, "value": round(value, 5), "unit": unit, "direction": direction, "tolerance": tolerance}


def worse(figures: Sequence[Figure], baseline: Sequence[Figure]) -> list[str]:
    """List the figures beyond their tolerance, a sentence each."""
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
    """Sum up how the tracker itself does in every experiment, and how many runs failed.

    Errors are medians over the seeds and, since the chance of single runs cancels there, their mean over the captures.
    """
    by, groups = metric_of(rows), dict[tuple[str, str, str], list[float]]()
    for row in rows:
        error = row.get(by.column)
        if row["method"] == "ours" and error is not None and np.isfinite(error):
            groups.setdefault((row["experiment"], row["capture"], row["value"]), []).append(float(error))
    pooled = _spread(list(groups.values()))
    figures, members = [], dict[tuple[str, str], list[list[float]]]()
    for (experiment, capture, value), errors in groups.items():
        metric = f"{experiment}, {capture}, {value}: {by.name}"
        spread = _spread([errors]) if len(errors) >= _ENOUGH else pooled
        figures.append(_error(metric, float(np.median(errors)), spread, len(errors)))
        members.setdefault((experiment, value), []).append(errors)
    for (experiment, value), every in members.items():
        if len(every) > 1:
            metric = f"{experiment}, mean of {len(every)} captures, {value}: {by.name}"
            spread = _spread(every) if len(every[0]) >= _ENOUGH else pooled
            mean = float(np.mean([np.median(errors) for errors in every]))
            figures.append(_error(metric, mean, spread, sum(map(len, every))))
    failed = len({row["key"] for row in rows if row["status"] != "done"})
    return [*figures, figure("failed runs", failed, "runs", 0.0)]


def _spread(groups: Sequence[Sequence[float]]) -> float:
    """Compute the standard deviation between an experiment's seeds, pooled over all groups that have several."""
    several = [errors for errors in groups if len(errors) > 1]
    if not several:
        return _SPREAD
    return float(np.sqrt(sum(np.var(e) * len(e) for e in several) / sum(len(e) - 1 for e in several)))


def _error(metric: str, value: float, spread: float, runs: int) -> Figure:
    """Record a median or mean of errors, with their standard deviation between seeds and how many they are."""
    about: Figure = {"spread": round(spread, 5), "runs": runs}
    return figure(metric, value, "cm", _tolerance(value, spread, runs)) | about


def _tolerance(value: float, spread: float, runs: float) -> float:
    return _TOLERANCE + 3 * spread / np.sqrt(runs) / max(value, 1e-6)


def _as_chance_allows(one: Figure, earlier: Figure | None) -> Figure:
    """Give the figure the tolerance that the spread of the baseline allows its runs, where the baseline knows one."""
    if earlier is None or "spread" not in earlier:
        return one
    value, spread, runs = (float(str(x)) for x in (earlier["value"], earlier["spread"], one["runs"]))
    return one | {"tolerance": _tolerance(value, spread, runs)}


def write_figures(figures: Sequence[Figure], path: Path, **about: Any) -> None:
    """Write the figures as a baseline for `complaints`; `about` says which runs they are of."""
    write_json(path, {**about, "figures": list(figures)})


def read_baseline(path: Path, **about: Any) -> list[dict[str, Any]]:
    """Read the figures of a baseline file.

    Raises `InputError` if it cannot be read, or is one of other runs (`about`, as in `write_figures`).
    """
    try:
        whole = json.loads(path.read_text())
        baseline = whole["figures"]
        _ = {entry["metric"]: float(entry["value"]) for entry in baseline}  # raises where entries are no figures
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(
            f"the baseline {path} cannot be read ({error}); give the figures.json of an earlier run."
        ) from None
    for name, value in about.items():
        if whole.get(name, value) != value:
            raise InputError(
                f"the baseline {path} has {name} {whole[name]}, this run {value}; give one of runs like these."
            )
    return baseline


def complaints(figures: Sequence[Figure], path: Path, **about: Any) -> list[str]:
    """List what is worse than in a baseline file, a sentence each.

    Raises `InputError` as `read_baseline` does, and where there is no figure in common.
    """
    baseline = read_baseline(path, **about)
    known = {entry["metric"]: entry for entry in baseline}
    missing = sorted(set(known) - {str(one["metric"]) for one in figures})
    if len(missing) == len(known):
        raise InputError(f"the baseline {path} is one of other experiments: it has no figure in common with this run.")
    allowed = [_as_chance_allows(one, known.get(one["metric"])) for one in figures]
    return [*worse(allowed, baseline), *(f"{metric}: not measured this time" for metric in missing)]
