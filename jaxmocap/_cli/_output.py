"""What a command says and where: its answer on standard output, messages and progress on standard error, pictures."""

import contextlib
import inspect
import json
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table

if TYPE_CHECKING:
    import numpy as np

Report = Callable[[str, int, int], None]
"""`report(stage, done, total)`: what is going on, and how far it is."""

_QUIET = 20.0
"""Seconds without a line, after which the next step of a stage is worth one away from a terminal."""


def say(message: str) -> None:
    """Write a line for people, on standard error."""
    Console(stderr=True, highlight=False, soft_wrap=True).print(message, markup=False)


def show(value: Any, as_text: Callable[[], Any], *, json_wanted: bool) -> None:
    """Write a command's answer on standard output: `value` as JSON alone, or `as_text()` as rich prints it, lines and
    tables as wide as they are where it is not read on a terminal."""
    if json_wanted:
        plain = json.loads(json.dumps(value, default=str), parse_constant=lambda _: None)  # NaN is no JSON
        print(json.dumps(plain, indent=2, allow_nan=False, ensure_ascii=False))
    else:
        console, text = Console(highlight=False), as_text()
        if not console.is_terminal:
            natural = console.measure(text, options=console.options.update(width=9999)).maximum
            console.width = max(console.width, natural)
        console.print(text, markup=False, crop=False)  # a path that is longer than a line stays whole


@contextlib.contextmanager
def progress() -> Iterator[Report]:
    """Report progress on standard error: a bar per stage on a terminal, elsewhere a line when a stage begins, at every
    tenth of a long one, and at a step that took long."""
    console = Console(stderr=True, highlight=False)
    columns = (
        TextColumn("{task.description:<24}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    bars = Progress(*columns, console=console, disable=not console.is_terminal)
    tasks, tenths, said = {}, {}, time.monotonic()

    def report(stage: str, done: int, total: int) -> None:
        nonlocal said
        tenth, line = 10 * done // max(total, 1), None
        if stage not in tasks:
            tasks[stage], tenths[stage] = bars.add_task(stage, total=total), tenth
            line = f"{stage} ..."
        elif (tenth > tenths[stage] and total >= 20) or time.monotonic() > said + _QUIET:
            tenths[stage] = tenth
            line = f"{stage} {done} of {total}"
        if line and not console.is_terminal:
            say(line)
            said = time.monotonic()
        bars.update(tasks[stage], completed=done, total=total)

    with bars:
        yield report


def write_png(path: Path, image: "np.ndarray") -> None:
    """Write an RGB uint8 image, atomically."""
    import cv2

    from jaxmocap._files import write_bytes

    write_bytes(path, cv2.imencode(".png", cv2.cvtColor(image, cv2.COLOR_RGB2BGR))[1].tobytes())


def mask_words(entry: dict) -> str:
    """Say an entry of a mask record in a word or two."""
    return f"{entry['source']} {entry['confidence']:.2f}" if "confidence" in entry else entry["source"]


def show_help(groups: Mapping[str, Mapping[str, Callable[..., int]]], description: str) -> None:
    """Print the commands by group, each with the first paragraph of what it says of itself."""
    console = Console(highlight=False)
    console.print("usage: jaxmocap COMMAND ...; jaxmocap COMMAND --help lists its options\n", markup=False)
    console.print(description, markup=False)
    for title, commands in groups.items():
        table = Table(box=None, show_header=False, padding=(0, 2, 0, 0), title=f"\n{title}", title_justify="left")
        table.add_column(width=max(len(name) for group in groups.values() for name in group), no_wrap=True)
        table.add_column()
        for name, command in commands.items():
            first = (inspect.getdoc(command) or "").partition("\n\n")[0]
            table.add_row(name, " ".join(first.split()))
        console.print(table)
