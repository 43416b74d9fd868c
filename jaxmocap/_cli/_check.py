"""`jaxmocap check`: everything that is wrong with a capture, at once."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from rich.table import Table
from rich.text import Text

from jaxmocap._results import InputError

from ._arguments import CapturePath, FrameSpan, Json, open_span
from ._output import say, show

if TYPE_CHECKING:
    from jaxmocap.capture import Finding

_STYLES = {"error": "bold red", "warning": "yellow", "note": "dim"}


def check(
    capture: CapturePath,
    picture: Annotated[
        Path | None,
        tyro.conf.arg(
            metavar="FILE.png",
            help="Draw the cameras' paths, the points and the person, from above and from the side.",
            help_behavior_hint="",
        ),
    ] = None,
    frames: FrameSpan = None,
    json: Json = False,
) -> int:
    """Say everything that is wrong with a capture, before tracking. Exits with 2 if there are errors."""
    span = open_span(frames)
    if picture is not None:
        _draw(capture, picture)
    findings = examine(capture, span)
    show([vars(finding) for finding in findings], lambda: findings_table(findings, capture), json_wanted=json)
    return 2 if any(finding.severity == "error" for finding in findings) else 0


def _draw(path: Path, file: Path) -> None:
    from jaxmocap._files import write_bytes
    from jaxmocap.calibration import draw_cameras, png_bytes
    from jaxmocap.capture import Capture

    if file.suffix.lower() != ".png":
        raise InputError(f"--picture is {file}; a file name that ends in .png was expected")
    image = draw_cameras(Capture.open(path))
    try:
        write_bytes(file, png_bytes(image))
    except OSError as error:
        raise InputError(f"{file} cannot be written: {error.strerror}") from error
    say(f"{file} shows the cameras.")


def examine(path: Path, frames: tuple[int, int | None] | None = None) -> "list[Finding]":
    """Find what is wrong with a capture, in some of its frames if asked, and with its actor, errors first."""
    from jaxmocap.capture import Finding, check

    findings = check(path, frames)
    order = ("error", "warning", "note")
    if not any(finding.severity == "error" for finding in findings):
        findings = findings + _about_actor(path)
    elif any(finding.where != "actor" for finding in findings):
        findings = [*findings, Finding("note", "actor", "was not examined; it is once the errors above are mended")]
    return sorted(findings, key=lambda finding: order.index(finding.severity))


def findings_table(findings: "list[Finding]", path: Path) -> Table | str:
    """Lay the findings out as a table, or say in one sentence that there are none."""
    if not findings:
        return f"{path}: nothing to complain about; it can be tracked."
    table = Table(title=str(path), title_justify="left")
    for column in ("", "Where", "What"):
        table.add_column(column, overflow="fold")
    for finding in findings:
        table.add_row(Text(finding.severity, style=_STYLES[finding.severity]), finding.where, finding.message)
    return table


def _about_actor(path: Path) -> "list[Finding]":
    from jaxmocap.capture import Capture, Finding
    from jaxmocap.character import stature
    from jaxmocap.pipeline import no_actor
    from jaxmocap.rigging import open_actor

    capture = Capture.open(path)
    if capture.actor is None:
        return [no_actor(capture)]
    try:
        said: list[str] = []
        character = open_actor(capture.actor, said.append)
    except InputError as error:
        return [Finding("error", "actor", str(error))]
    height = float(stature(character))
    note = f"{character.name}: {len(character.faces)} triangles, {height:.2f} m tall at rest"
    return [Finding("note", "actor", note), *(Finding("note", "actor", message) for message in said)]
