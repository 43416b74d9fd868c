"""`jaxmocap export`: a result as files of other programs."""

from pathlib import Path
from typing import Annotated, Literal

import tyro
from rich.table import Table

from jaxmocap._results import InputError

from ._arguments import Json
from ._output import say, show


def export(
    result: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR", help="Folder that track wrote.")],
    to: Annotated[
        tuple[Path, ...],
        tyro.conf.arg(
            metavar="FILE ...",
            help="New files, each in the format of its suffix: .glb .fbx .blend .bvh .c3d .trc .mot .osim .csv "
            ".isb.csv .isb.mot .gait.json .parquet .usd .usda .usdc .colmap.",
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
    actor: Annotated[
        Path | None,
        tyro.conf.arg(
            metavar="FILE.glb",
            help="Character whose file .glb, .fbx and .blend move, where the tracked one's has gone elsewhere.",
            help_behavior_hint="(default: the tracked one's)",
        ),
    ] = None,
    mass: Annotated[
        float | None,
        tyro.conf.arg(
            metavar="KG",
            help="The person's mass, for .osim.",
            help_behavior_hint="(default: that of the mesh, of water)",
        ),
    ] = None,
    opensim_model: Annotated[
        tuple[Path, ...],
        tyro.conf.arg(
            metavar="FILE ...",
            help="Another model for .osim, scaled and moved by OpenSim; its marker set after it, if that is a file.",
            help_behavior_hint="(default: a model of this person)",
        ),
    ] = (),
    rig: Annotated[
        Path | None,
        tyro.conf.arg(
            metavar="FILE.glb",
            help="Another skinned person, such as Mixamo's or Unreal's, to move instead: .glb .bvh .fbx .blend.",
            help_behavior_hint="(default: the actor's own)",
        ),
    ] = None,
    mapping: Annotated[
        Path | None,
        tyro.conf.arg(
            metavar="FILE.toml",
            help='Joints of the rig that are not recognised: "file joint" = "body" per line, TOML or JSON.',
            help_behavior_hint="",
        ),
    ] = None,
    json: Json = False,
) -> int:
    """Write the motion for other programs: Blender, Unreal, OpenSim, Mokka, COLMAP, spreadsheets."""
    from jaxmocap.exporters import EXPORTERS, ExportForm, checked_exporter, export_motion
    from jaxmocap.motion import Motion

    if not to:
        raise InputError("--to names no file; give one at least, such as --to dance.glb.")
    if len(set(to)) < len(to):
        raise InputError("--to names a file twice; give every file once.")
    form = ExportForm(
        "",
        frame_rate=frame_rate,
        actor=actor,
        mass=mass,
        opensim_model=opensim_model,
        rig=rig,
        mapping=mapping,
        say=say,
    )
    checked = {path: checked_exporter(path, EXPORTERS, units, up, form) for path in to}
    if opensim_model and not any(EXPORTERS[".osim"].driven is exporter for exporter in checked.values()):
        raise InputError("--opensim-model is for .osim, which --to does not name; add one, or leave the model out.")
    parts = {path: exporter.parts(path) for path, exporter in checked.items()}
    beside = {part: path for path in to for part in parts[path] if part != path}
    motion, forms = Motion.load(result), {}
    for path in sorted(to, key=beside.__contains__):
        forms[path] = forms.get(beside.get(path)) or export_motion(motion, path, EXPORTERS, units, up, form)
    written = [
        {"file": part, "units": forms[path].units, "up": forms[path].up, "frame_rate": forms[path].frame_rate}
        for path in to
        for part in parts[path]
        if part == path or part not in to
    ]
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
