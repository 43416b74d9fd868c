"""The page of a batch: every take's verdict and figures, with a link to its report."""

import os
from collections.abc import Sequence
from html import escape
from pathlib import Path
from urllib.parse import quote

from jaxmocap.viewers import plain_page

from ._take_result import TakeResult

_HEAD = ("Take", "Verdict", "Frames trusted", "Seconds", "Markers, cm", "Joints, cm")
_COLOURS = {"failed": "lost", "waiting": "soft"}


def batch_headline(takes: Sequence[TakeResult]) -> str:
    """Say in one sentence how the takes turned out."""
    counts = {
        "trusted throughout": sum(take.trusted for take in takes),
        "not throughout": sum(take.frames > 0 and not take.trusted for take in takes),
        "failed": sum(take.way == "failed" for take in takes),
        "still to do": sum(take.way == "waiting" for take in takes),
    }
    told = ", ".join(f"{count} {what}" for what, count in counts.items() if count)
    return f"{len(takes)} take{'s' * (len(takes) > 1)}: {told}."


def batch_page(takes: Sequence[TakeResult], out: Path) -> str:
    """Write the page of a batch whose results are in `out`; links are relative to it."""
    head = "".join(f'<th scope="col">{cell}</th>' for cell in _HEAD)
    rows = "\n".join(_row(take, out) for take in takes)
    return plain_page(
        out.resolve().name,
        f'<h1>{escape(out.resolve().name)}</h1>\n<p id="headline">{escape(batch_headline(takes))}</p>\n'
        f"<section><table>\n<thead><tr>{head}</tr></thead>\n<tbody>\n{rows}\n</tbody>\n</table></section>",
    )


def _row(take: TakeResult, out: Path) -> str:
    colour = _COLOURS.get(take.way, "ok" if take.trusted else "doubtful")
    more = "".join(f'<p class="hint">{escape(sentence)}</p>' for sentence in (*take.findings, *take.notes))
    cells = (
        _link(take, out),
        f'<strong style="color: var(--{colour})">{escape(take.verdict)}</strong>{more}',
        f"{take.trusted_frames} of {take.frames}" if take.frames else "",
        "" if take.seconds is None else f"{take.seconds:.0f} ({take.way})",
        "" if take.marker_error_cm is None else f"{take.marker_error_cm:.2f}",
        "" if take.joint_error_cm is None else f"{take.joint_error_cm:.2f}",
    )
    return f"<tr>{''.join(f'<td>{cell}</td>' for cell in cells)}</tr>"


def _link(take: TakeResult, out: Path) -> str:
    if take.report is None:
        return escape(take.name)
    place = os.path.relpath(take.report, out).replace(os.sep, "/")
    return f'<a href="{escape(quote(place))}">{escape(take.name)}</a>'
