"""`jaxmocap export`: a result as files of other programs."""

from pathlib import Path
from typing import Annotated, Literal

import tyro
from rich.table import Table

from jaxmocap._results import InputError

from ._arguments import ActorFile, Json
from ._output import say, show


def export(
    result: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR", help="Folder that track wrote.")],
    to: Annotated[
        tuple[Path, ...],
        tyro.conf.arg(
            metavar="FILE ...",
            help="New files, each in the format of its suffix: .glb .bvh .c3d .trc .mot .csv .parquet .usd .colmap.",
        ),
    ],
    units: Annotated[
        Literal["m", "cm", "mm"] | None,
        tyro.conf.arg(metavar="{m,cm,mm}", help="Unit of lengths.", help_behavior_hint="(default: the format's)"),
    ] = None,
    up: Annotated[
        Literal["y", "z"] | None,
        tyro.conf.arg(metavar="{y,z}", help="Vertical axis.", help_behavior_hint="(default: the format's)"),
    ] = None,
    frame_rate: Annotated[
        float | None,
        tyro.conf.arg(
            metavar="F",
            help="Frames per second; poses are interpolated.",
            help_behavior_hint="(default: the frames as they were filmed)",
        ),
    ] = None,
    actor: ActorFile = None,
    json: Json = False,
) -> int:
    """Write the motion for other programs: Blender, Unreal, OpenSim, Mokka, COLMAP, spreadsheets."""
    from jaxmocap.exporters import EXPORTERS, checked_exporter, export_motion
    from jaxmocap.motion import Motion

    if len(set(to)) < len(to):
        raise InputError("--to names a file twice; give every file once.")
    for path in to:
        checked_exporter(path, EXPORTERS, units, up, frame_rate)
    motion = Motion.load(result)
    written = []
    for path in to:
        form = export_motion(motion, path, EXPORTERS, units=units, up=up, frame_rate=frame_rate, actor=actor, say=say)
        written.append({"file": path, "units": form.units, "up": form.up, "frame_rate": form.frame_rate})
    show({"files": written}, lambda: _table(written), json_wanted=json)
    return 0


def _table(written: list[dict]) -> Table:
    table = Table()
    for column in ("File", "units", "up", "frames per second"):
        table.add_column(column)
    for row in written:
        rate = "as filmed" if row["frame_rate"] is None else f"{row['frame_rate']:.4g}"
        table.add_row(str(row["file"]), row["units"], row["up"], rate)
    return table
