"""What every benchmark writes: small records, a table on the terminal, a file, and a gate against a committed one."""

import argparse
import json
import os
import sys
from pathlib import Path

from jaxmocap.experiments import Figure as Figure, figure as record, worse  # noqa: F401


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
