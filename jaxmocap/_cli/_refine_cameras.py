"""`jaxmocap refine-cameras`: cameras and offsets from background and tracked body together."""

from pathlib import Path
from typing import Annotated, Any

import tyro
from rich.table import Table

from ._arguments import CapturePath, Json
from ._output import progress, show


def refine_cameras(
    capture: CapturePath,
    result: Annotated[
        Path, tyro.conf.Positional, tyro.conf.arg(metavar="RESULT", help="Folder that track wrote for this capture.")
    ],
    detections: Annotated[
        Path | None,
        tyro.conf.arg(
            metavar="DIR",
            help="A detector's keypoints at the tracked frames (files as the capture's may be).",
            help_behavior_hint="(default: the capture's)",
        ),
    ] = None,
    json: Json = False,
) -> int:
    """Refine cameras, and the offsets to a part of a frame, by background and tracked body, and complete capture.toml.

    The body needs keypoints in two views at tracked frames; the more, the better.
    """
    from jaxmocap.calibration import refine_cameras

    with progress() as report:
        found = refine_cameras(capture, result, detections=detections, progress=report)
    answer = {"folder": found.folder, **found.record}
    show(answer, lambda: _table(found.record, found.folder or capture), json_wanted=json)
    return 0


def _table(record: dict[str, Any], path: Path) -> Table:
    pairs = ", ".join(
        f"{name} {before:.2f} -> {after:.2f}"
        for name, (before, after) in record["residuals_pixels"].items()
        if before is not None
    )
    caption = f"Median residuals in pixels: {pairs}; {record['seconds']:.0f} s. Track again with the refined cameras."
    table = Table(title=str(path), title_justify="left", caption=caption, caption_justify="left")
    for column in ("Camera", "Offset, s", "changed by, ms", "±", "Focal", "Moved, cm", "at most", "Turned, deg"):
        table.add_column(column, justify="left" if column == "Camera" else "right")
    for name, camera in record["cameras"].items():
        table.add_row(
            name,
            f"{camera['offset_seconds']:+.4f}",
            f"{1000 * camera['late_seconds']:+.2f}",
            f"{1000 * camera['late_deviation_seconds']:.2f}",
            f"x {camera['focal_factor']:.4f}",
            f"{100 * camera['moved_m']:.2f}",
            f"{100 * camera['moved_most_m']:.2f}",
            f"{camera['turned_degrees']:.3f}",
        )
    return table
