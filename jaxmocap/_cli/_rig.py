"""`jaxmocap rig`: a bare mesh becomes a character that tracks."""

import json as json_module
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
from rich.table import Table

from jaxmocap._results import InputError

from ._arguments import Json, named_places
from ._output import say, show, write_png

Axis = Literal["x", "y", "z", "-x", "-y", "-z"]
_AXES = "{x,y,z,-x,-y,-z}"


def rig(
    mesh: Annotated[
        Path,
        tyro.conf.Positional,
        tyro.conf.arg(
            metavar="MESH",
            help="A person who stands, OBJ, PLY, STL, OFF or GLB; or a skinned GLB or body model, whose skin is kept.",
        ),
    ],
    out: Annotated[
        Path | None,
        tyro.conf.arg(metavar="FILE.glb", help="New file for the character.", help_behavior_hint="(required)"),
    ] = None,
    triangles: Annotated[int, tyro.conf.arg(metavar="N", help="Simplify to about so many triangles.")] = 5000,
    height: Annotated[
        float | None,
        tyro.conf.arg(metavar="METRES", help="How tall the person is.", help_behavior_hint="(default: from the units)"),
    ] = None,
    units: Annotated[
        Literal["m", "cm", "mm", "in", "ft", "dm"] | None,
        tyro.conf.arg(
            metavar="{m,cm,mm,in,ft,dm}",
            help="The file's units.",
            help_behavior_hint="(default: those that make an adult)",
        ),
    ] = None,
    up: Annotated[
        Axis | None,
        tyro.conf.arg(metavar=_AXES, help="The file's axis that points up.", help_behavior_hint="(default: found)"),
    ] = None,
    front: Annotated[
        Axis | None,
        tyro.conf.arg(
            metavar=_AXES, help="The file's axis that the person faces.", help_behavior_hint="(default: found)"
        ),
    ] = None,
    joints: Annotated[
        Path | None,
        tyro.conf.arg(
            metavar="FILE.json",
            help='Joints whose places are known, in the file\'s units and axes: {"l_elbow": [0.35, 1.2, 0.02]}.',
            help_behavior_hint="",
        ),
    ] = None,
    joint: Annotated[
        tuple[str, ...],
        tyro.conf.arg(
            metavar="NAME=X,Y,Z ...",
            help="Single ones in the same way, such as l_elbow=0.35,1.2,0.02; they overrule those of the file.",
            help_behavior_hint="",
        ),
    ] = (),
    pictures: Annotated[
        Path | None,
        tyro.conf.arg(
            metavar="DIR",
            help="Instead of rigging, draw the mesh from three sides into a new folder, for a detector of keypoints.",
            help_behavior_hint="",
        ),
    ] = None,
    keypoints: Annotated[
        Path | None,
        tyro.conf.arg(
            metavar="DIR",
            help="What a detector found in these pictures (files as a capture's may be, front_keypoints.json beside "
            "front.png): tells up, front, and about where joints are.",
            help_behavior_hint="",
        ),
    ] = None,
    mapping: Annotated[
        Path | None,
        tyro.conf.arg(
            metavar="FILE.toml",
            help='Joints of a skinned file that are not recognised: "file joint" = "body" per line, TOML or JSON.',
            help_behavior_hint="",
        ),
    ] = None,
    anew: Annotated[bool, tyro.conf.arg(help="Do not keep a skin that the file has.", help_behavior_hint="")] = False,
    picture: Annotated[
        Path | None,
        tyro.conf.arg(
            metavar="FILE.png",
            help="Draw the character with its joints, and bent at elbows, shoulders, knees and hips.",
            help_behavior_hint="",
        ),
    ] = None,
    json: Json = False,
) -> int:
    """Give a mesh of a standing person a skeleton and skinning weights, for `--actor` or capture.toml."""
    if pictures is not None:
        if out is not None or keypoints is not None:
            raise InputError("--pictures only draws; give --out and --keypoints to a second call, after the detector.")
        return _draw(mesh, pictures, up, front, json_wanted=json)
    if out is None:
        raise InputError("--out FILE.glb is needed, a new file for the character (or --pictures DIR).")

    from jaxmocap._files import atomic_path
    from jaxmocap.rigging import rig

    refuse_unusable(out)
    if picture is not None and picture.suffix.lower() != ".png":
        raise InputError(f"--picture is {picture}; a file name that ends in .png was expected.")
    known = ({} if joints is None else _read_joints(joints)) | named_places(
        joint, "--joint", "NAME=X,Y,Z", "l_elbow=0.35,1.2,0.02"
    )
    rigged = rig(
        mesh,
        num_faces=triangles,
        height=height,
        units=units,
        up=up,
        front=front,
        joints=known or None,
        keypoints=keypoints,
        mapping=mapping,
        anew=anew,
    )
    with atomic_path(out) as temporary:
        rigged.character.save_glb(temporary)
    if picture is not None:
        from jaxmocap.viewers import draw_character

        write_png(picture, draw_character(rigged.character))
    show({"out": out, **rigged.report}, lambda: _table(rigged.report, out), json_wanted=json)
    for warning in rigged.report["warnings"]:
        say(f"{mesh}: {warning}.")
    return 0


def _draw(mesh: Path, folder: Path, up: Axis | None, front: Axis | None, json_wanted: bool) -> int:
    from jaxmocap.viewers import rig_pictures

    names = rig_pictures(mesh, folder, up=up, front=front).names
    drawn = [f"{name}.png" for name in names]
    text = (
        f"{folder}: {', '.join(drawn)}. If the person stands upright there, run a detector of "
        f"people, put what it finds beside them ({names[0]}_keypoints.json and so on) and rig with --keypoints "
        f"{folder}; else say --up and --front."
    )
    show({"pictures": folder, "files": drawn}, lambda: text, json_wanted=json_wanted)
    return 0


def refuse_unusable(out: Path) -> None:
    """Refuse an output that is not a new GLB file."""
    if out.suffix.lower() != ".glb":
        raise InputError(f"--out is {out}; a character is written as a file that ends in .glb.")
    if out.exists():
        raise InputError(f"{out} exists already; choose a new file with --out.")


def _read_joints(path: Path) -> dict[str, Any]:
    if not path.is_file():
        raise InputError(f"{path} does not exist; a JSON file of joints and their places was expected.")
    try:
        content = json_module.loads(path.read_text(encoding="utf-8", errors="replace"))
    except ValueError as error:
        raise InputError(f"{path} is not readable as JSON: {error}.") from None
    if not isinstance(content, dict):
        raise InputError(f'{path} must be one table of joint = place, such as {{"l_elbow": [0.35, 1.2, 0.02]}}.')
    return content


def _table(report: dict[str, Any], out: Path) -> Table:
    table = Table(title=str(out), title_justify="left", show_header=False)
    count = report["triangles"]
    kept = report["skin"] == "kept"
    surface = "" if kept else f", {'closed' if report['closed'] else 'open'}"
    table.add_row("triangles", f"{count['after']:,} of {count['before']:,}{surface}")
    for number, repair in enumerate(report["repairs"] or ["none needed"]):
        table.add_row("" if number else "repairs", repair)
    folds = ("skin turned inside out", f"{100 * report['turned_out']:.1f} % at the worst limit of a joint")
    if kept:
        table.add_row("size", f"{report['height_m']:.2f} m tall")
        table.add_row("skin", "the file's own is kept")
        table.add_row(*folds)
        return table
    table.add_row("size", f"{report['height_m']:.2f} m tall, units: {report['units']}")
    table.add_row("axes of the file", f"up {report['up']}, front {report['front']}")
    table.add_row("body against mesh", f"{report['distance_cm']:.1f} cm in the median")
    table.add_row(*folds)
    if report["keypoints"] is not None:
        off = sorted(report["keypoints"]["off_cm"].items(), key=lambda pair: pair[1])
        words = f"joints {off[len(off) // 2][1]:.1f} cm off them in the median, {off[-1][0]} {off[-1][1]:.1f} cm"
        table.add_row("keypoints", words)
    if report["front_margin"] is not None:
        table.add_row("front", f"the other way round fits {100 * report['front_margin']:.0f} % worse")
    return table
