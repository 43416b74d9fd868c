"""The report page: one HTML file by which a result can be judged, in any browser and without a network."""

import base64
import hashlib
import html
import json
import os
from collections.abc import Callable
from importlib.resources import files
from pathlib import Path
from string import Template

from jaxmocap._files import write_text
from jaxmocap._results import InputError
from jaxmocap.capture import Capture
from jaxmocap.motion import Motion

from ._report_findings import findings, headline
from ._report_pictures import ReportPictures, report_pictures
from ._report_record import read_report, report_record

REPORT_PAGE = "report.html"
_SCRIPTS = ("overlays.js", "charts.js", "page.js")


def report_page(
    result: str | os.PathLike[str],
    *,
    capture: Capture | None = None,
    say: Callable[[str], None] | None = None,
) -> Path:
    """Write `report.html` into a result folder, atomically, and return its path; `track` does so by itself.

    The page holds everything it shows and asks nothing of a network: the verdict, overlays to scrub through, energies,
    confidence, joint angles, foot skate, jitter, timings and settings. Pictures are those of the overlay videos, or
    drawn over the images of `capture` (else of the capture that was tracked); without either the page has none, and
    says so, to `say` too. Raises `InputError` if `result` is no result or cannot be written to.
    """
    folder = Path(result)
    if not folder.is_dir():
        raise InputError(f"{folder} is not a folder; give the folder that track wrote.")
    motion = Motion.load(folder)
    pictures, missing = _pictures(folder, motion, capture)
    if missing and say is not None:
        say(f"The report page has no pictures: {missing}.")
    path = folder / REPORT_PAGE
    try:
        write_text(path, page_html(motion, read_report(folder / "report.json"), pictures, missing))
    except OSError as error:
        raise InputError(f"{path} cannot be written ({error.strerror or error}).") from error
    return path


def page_html(motion: Motion, report: dict, pictures: ReportPictures, missing: str = "") -> str:
    """Fill the page in. Whatever comes from files goes in escaped, or as JSON that the script shows as text."""
    record = report_record(motion, report)
    record |= {"views": list(pictures.names), "positions": pictures.positions, "pictures": pictures.pictures}
    script = "\n".join(_asset(name) for name in _SCRIPTS)
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode("ascii")
    title = str(motion.provenance.get("capture_name") or motion.character.name)
    return Template(_asset("page.html")).substitute(
        title=html.escape(title),
        digest=digest,
        style=_asset("style.css"),
        script=script,
        headline=html.escape(headline(motion)),
        findings="\n".join(_item(**finding) for finding in findings(motion)),
        missing=html.escape(f"No pictures: {missing}." if missing else ""),
        data=json.dumps(record, ensure_ascii=True, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c"),
    )


def _pictures(folder: Path, motion: Motion, capture: Capture | None) -> tuple[ReportPictures, str]:
    """Draw the pictures, or say why there are none."""
    none = ReportPictures((), (), ())
    if motion.cameras is None:
        return none, "this motion has no cameras"
    recorded = motion.provenance.get("capture")
    try:
        return report_pictures(folder, motion, capture), ""
    except InputError as error:
        if capture is not None or not recorded:
            return none, str(error).rstrip(".")
    try:
        return report_pictures(folder, motion, Capture.open(recorded)), ""
    except InputError as error:
        return none, str(error).rstrip(".")


def _item(kind: str, text: str, frames: list[int], entry: str) -> str:
    more = f' <span class="hint">In the guide: {html.escape(entry)}.</span>' if entry else ""
    buttons = "".join(f' <button type="button" data-frame="{frame}">{frame}</button>' for frame in frames)
    return f'<li class="{kind.replace(" ", "-")}"><span>{html.escape(text)}</span>{more}{buttons}</li>'


def _asset(name: str) -> str:
    return (files("jaxmocap.viewers") / "assets" / name).read_text(encoding="utf-8")


def plain_page(title: str, body: str) -> str:
    """Write one HTML page without scripts that looks like the report page; `body` is HTML, `title` text."""
    return Template(_asset("plain.html")).substitute(title=html.escape(title), style=_asset("style.css"), body=body)
