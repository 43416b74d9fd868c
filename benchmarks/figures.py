"""What every benchmark writes: small records, a table on the terminal, a file, and a gate against a committed one."""

import argparse
import json
import os
import sys
from pathlib import Path
from typing import Literal

Figure = dict[str, object]


def record(
    metric: str, value: float, unit: str, tolerance: float, direction: Literal["lower", "higher"] = "lower"
) -> Figure:
    """One figure: which direction is better, and by how much of itself it may get worse."""
    return {"metric": metric, "value": round(value, 5), "unit": unit, "direction": direction, "tolerance": tolerance}


def worse(figures: list[Figure], baseline: list[Figure]) -> list[str]:
    """Sentences about figures beyond their tolerance."""
    before = {entry["metric"]: float(str(entry["value"])) for entry in baseline}
    found = []
    for figure in figures:
        if figure["metric"] not in before:
            continue
        now, was = float(str(figure["value"])), before[figure["metric"]]
        by = now - was if figure["direction"] == "lower" else was - now
        if by > abs(was) * float(str(figure["tolerance"])) + 1e-9:
            found.append(f"{figure['metric']}: {now} {figure['unit']}, was {was}")
    return found


def add_options(parser: argparse.ArgumentParser) -> None:
    """`--out` and `--gate`, which all benchmarks have."""
    parser.add_argument("--out", type=Path, help="write the figures to this file")
    parser.add_argument("--gate", type=Path, help="exit with 1 if a figure is worse than in this file")


def finish(figures: list[Figure], options: argparse.Namespace, **about: object) -> int:
    """Print, write and compare as the options say; the exit code."""
    for figure in figures:
        print(f"{figure['metric']:70s} {float(str(figure['value'])):12.4f} {figure['unit']}")
    if options.out:
        options.out.write_text(json.dumps({"cores": os.cpu_count(), **about, "figures": figures}, indent=1) + "\n")
    if options.gate:
        complaints = worse(figures, json.loads(options.gate.read_text())["figures"])
        print(*complaints, sep="\n", file=sys.stderr)
        return 1 if complaints else 0
    return 0
