"""What every benchmark writes: small records, a table on the terminal, a file, and a gate against a committed one."""

import argparse
import json
import os
import sys
from pathlib import Path

from jaxmocap._files import write_text
from jaxmocap._results import InputError
from jaxmocap.experiments import Figure as Figure, complaints, figure as record, read_baseline  # noqa: F401

_SAME = ("capture", "captures", "frames", "quality")
"""What a baseline and the runs that are held against it must have in common, where both say it."""


def add_options(parser: argparse.ArgumentParser) -> None:
    """`--out` and `--gate`, which all benchmarks have."""
    parser.add_argument("--out", type=Path, help="write the figures to this file")
    parser.add_argument("--gate", type=_baseline, help="exit with 1 if a figure is worse than in this file, or missing")


def _baseline(text: str) -> Path:
    """Refuse a file that is no baseline before anything is measured."""
    try:
        read_baseline(Path(text))
    except InputError as error:
        raise argparse.ArgumentTypeError(str(error)) from None
    return Path(text)


def finish(figures: list[Figure], options: argparse.Namespace, **about: object) -> int:
    """Print, compare and write as the options say; the exit code."""
    for figure in figures:
        print(f"{figure['metric']:70s} {float(str(figure['value'])):12.4f} {figure['unit']}")
    try:
        same = {name: value for name, value in about.items() if name in _SAME}
        found = complaints(figures, options.gate, **same) if options.gate else []
    except InputError as error:
        found = [str(error)]
    if options.out:  # which may be the file of the gate
        write_text(options.out, json.dumps({"cores": os.cpu_count(), **about, "figures": figures}, indent=1) + "\n")
    for complaint in found:
        print(complaint, file=sys.stderr)
    return 1 if found else 0
