"""`jaxmocap cameras`: the cameras of a capture from, and for, another program."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_args

import numpy as np
import tyro
from rich.table import Table

from jaxmocap._results import InputError

from ._arguments import CapturePath, Json
from ._output import say, show

if TYPE_CHECKING:
    from jaxmocap.camera import Cameras

Form = Literal["colmap", "colmap-binary", "aniposelib", "pose2sim", "freemocap", "easymocap", "qualisys", "opencv"]


def cameras(
    capture: CapturePath,
    to: Annotated[
        Form | None,
        tyro.conf.arg(
            metavar="{" + ",".join(get_args(Form)) + "}",
            help="Write the cameras in this form, described in docs/conventions.md.",
            help_behavior_hint="",
        ),
    ] = None,
    out: Annotated[
        Path | None, tyro.conf.arg(metavar="PATH", help="Where to: a new file or folder.", help_behavior_hint="")
    ] = None,
    take: Annotated[
        Path | None,
        tyro.conf.arg(
            name="from",
            metavar="PATH",
            help="Copy this calibration, of any of these forms, into the capture and name it in capture.toml.",
            help_behavior_hint="",
        ),
    ] = None,
    replace: Annotated[
        bool,
        tyro.conf.arg(help="With --from: though capture.toml names cameras; they are kept.", help_behavior_hint=""),
    ] = False,
    json: Json = False,
) -> int:
    """List the cameras of a capture; write them for another program with --to and --out, take others with --from."""
    from jaxmocap.calibration import adopt_cameras
    from jaxmocap.camera import write_cameras
    from jaxmocap.capture import Capture

    if (to is None) != (out is None):
        raise InputError("--to says in which form the cameras are written and --out where to; give both")
    if take is not None:
        say(f"{adopt_cameras(capture, take, replace=replace)} is named in capture.toml.")
    opened = Capture.open(capture).as_recorded()
    found = opened.cameras
    if to is not None and out is not None:
        say(f"{write_cameras(found, out, to, opened.video_frames)} written.")
        cut = [name for name in found.names if " " in name] if to == "colmap" else []
        if cut:
            say(f"COLMAP itself ends the images' names at a blank, as in '{cut[0]}'; --to colmap-binary keeps it.")
    record = _record(found)
    show(record, lambda: _table(record, capture), json_wanted=json)
    return 0


def _record(found: "Cameras") -> dict[str, Any]:
    centres = np.asarray(found.centres(), float)
    return {
        name: {
            "size": list(found.sizes[index]),
            "focal_pixels": [float(found.intrinsics[index, 0, 0]), float(found.intrinsics[index, 1, 1])],
            "centre_pixels": [float(value) for value in found.intrinsics[index, :2, 2]],
            "distortion": [float(value) for value in found.distortion[index]],
            "first_place_m": centres[index, 0].tolist(),
            "travels_m": float(np.linalg.norm(np.diff(centres[index], axis=0), axis=1).sum()),
        }
        for index, name in enumerate(found.names)
    }


def _table(record: dict[str, Any], path: Path) -> Table:
    caption = "Focal lengths and centres in pixels, the centre of the first pixel at (0.5, 0.5); places in metres."
    table = Table(title=str(path), title_justify="left", caption=caption, caption_justify="left")
    for column in ("Camera", "Size", "Focal", "Centre", "Distortion k1 k2 p1 p2 k3", "First place", "Travels"):
        table.add_column(column)
    for name, camera in record.items():
        table.add_row(
            name,
            "x".join(map(str, camera["size"])),
            " ".join(f"{value:.1f}" for value in camera["focal_pixels"]),
            " ".join(f"{value:.1f}" for value in camera["centre_pixels"]),
            " ".join(f"{value:.4g}" for value in camera["distortion"]),
            " ".join(f"{value:.2f}" for value in camera["first_place_m"]),
            f"{camera['travels_m']:.2f}",
        )
    return table
