"""`jaxmocap sync`: when each video started."""

from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro
from rich.table import Table

from ._arguments import CaptureOrVideos, FrameSpan, Json, NewCapture, open_span
from ._output import progress, say, show

if TYPE_CHECKING:
    from jaxmocap.capture import Synchronisation


def sync(
    capture: CaptureOrVideos,
    out: NewCapture = None,
    method: Annotated[
        Literal["auto", "flash", "sound", "motion"],
        tyro.conf.arg(help="What to go by; auto asks all and says where they disagree."),
    ] = "auto",
    frames: FrameSpan = None,
    json: Json = False,
) -> int:
    """Find when each video started, by a flash, by sound or by motion, and write the offsets into capture.toml.

    --frames are those of each video that count, numbered from its own first."""
    from jaxmocap.pipeline import sync

    with progress() as report:
        found = sync(capture, out, method=method, frames=open_span(frames) or (0, None), progress=report)
    if out is not None:
        say(f"{out} is a new capture, with copies of the videos; next: jaxmocap detect {out}.")
    record = found.record()
    for note in found.notes:
        say(f"{note}.")
    show(record, lambda: _table(found, record), json_wanted=json)
    return 0


def _table(found: "Synchronisation", record: dict[str, Any]) -> Table:
    offsets = "; ".join(
        f"{name} {camera['offset_seconds']:+.4f} s = {camera['offset_frames']:+.2f} frames"
        for name, camera in record["cameras"].items()
    )
    undecided = [
        f"{', '.join(pair['cameras'])} by {method}: {reason}"
        for pair in record["pairs"]
        for method, reason in pair["undecided"].items()
    ]
    table = Table(
        title=f"offsets: {offsets}", title_justify="left", caption="\n".join(undecided), caption_justify="left"
    )
    for column in ("Cameras", "By", "Offset, s", "frames", "whole", "Confidence", ""):
        table.add_column(column, justify="right" if column in ("Offset, s", "frames", "whole") else "left")
    for pair in record["pairs"]:
        cameras = ", ".join(pair["cameras"])
        for method, one in pair["estimates"].items():
            used = "used" if method == pair["used"] else ""
            seconds, frames, whole = one["offset_seconds"], one["offset_frames"], one["whole_frames"]
            table.add_row(
                cameras, method, f"{seconds:+.4f}", f"{frames:+.3f}", f"{whole:+d}", f"{one['confidence']:.3f}", used
            )
    return table
