"""`jaxmocap fit-character`: a generic character made to the measure of the filmed person."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro
from rich.table import Table

from ._arguments import ActorFile, CapturePath, Height, Json
from ._output import progress, say, show
from ._rig import refuse_unusable

if TYPE_CHECKING:
    from jaxmocap.capture import Capture
    from jaxmocap.character import Character
    from jaxmocap.registration import CharacterFit


def fit_character(
    capture: CapturePath,
    out: Annotated[Path, tyro.conf.arg(metavar="CHARACTER.glb", help="New file for the fitted character.")],
    actor: ActorFile = None,
    at: Annotated[
        tuple[int, ...],
        tyro.conf.arg(
            metavar="N ...",
            help="Frames to fit at, three or more, with keypoints in two views.",
            help_behavior_hint="(default: the selected frames)",
        ),
    ] = (),
    height: Height = None,
    scale_cameras: Annotated[
        bool,
        tyro.conf.arg(
            help="Take --height to be better known than the cameras' scale: scale the cameras to it, in a new folder "
            "that capture.toml names then, and the character with them.",
        ),
    ] = False,
    json: Json = False,
) -> int:
    """Fit bone lengths and girths of a generic actor to the person filmed, for use as `--actor` or in capture.toml."""
    import numpy as np

    from jaxmocap import calibration
    from jaxmocap._files import atomic_path
    from jaxmocap._results import InputError
    from jaxmocap.capture import Capture
    from jaxmocap.character import BodyShape, scaled, stature
    from jaxmocap.registration import fit_character

    refuse_unusable(out)
    if scale_cameras and height is None:
        raise InputError("--scale-cameras scales the cameras to the person's height; say it with --height METRES")
    opened = Capture.open(capture).one_way_up()
    generic, held = _generic(opened, actor, height), height
    if scale_cameras and height is not None:
        generic, held = scaled(generic, BodyShape.of(float(np.log(height / stature(generic))))), None
    with progress() as report:
        fit = fit_character(opened, opened.cameras, generic, at or None, height=held, progress=report)
    if scale_cameras and height is not None:
        if not fit.num_masks:
            raise InputError(
                f"capture '{opened.name}' has no mask at frames {', '.join(map(str, fit.poses))}, and only outlines "
                f"tell the cameras' scale; find some (jaxmocap segment {opened.folder} --out outlines), put them into "
                "the capture and name them as masks, or let jaxmocap run do it all; nothing was changed."
            )
        fit = fit.scaled_to(height)
    with atomic_path(out) as temporary:
        fit.character.save_glb(temporary)
        if scale_cameras:
            cameras = calibration.scale_cameras(capture, fit.camera_scale)
            say(f"The cameras' positions were multiplied by {fit.camera_scale:.3f}, in {cameras}.")
    record = fit_record(fit, generic)
    show({"out": out, **record}, lambda: _table(record, out), json_wanted=json)
    return 0


def _generic(capture: "Capture", actor: Path | None, height: float | None) -> "Character":
    from jaxmocap.pipeline import open_character
    from jaxmocap.rigging import body

    if actor is None and capture.actor is None:
        say(f"capture '{capture.name}' names no actor: the built-in body is made to measure.")
        return body(height)
    return open_character(capture, actor, say)


def fit_record(fit: "CharacterFit", generic: "Character") -> dict[str, Any]:
    """Describe what was fitted, in centimetres; scales are relative to the generic character."""
    import numpy as np

    from jaxmocap.character import GIRTHS, bone_lengths

    before, after = bone_lengths(generic.skeleton), bone_lengths(fit.character.skeleton)
    height, girths = fit.shape.height, np.exp(np.asarray(fit.shape.height + fit.shape.girths))
    centimetres = lambda metres: round(100 * float(metres), 2)  # noqa: E731
    return {
        "frames": list(fit.poses),
        "masks": fit.num_masks,
        "height_scale": round(float(np.exp(height)), 4),
        "bones_cm": {
            name: {"generic": centimetres(before[name]), "fitted": centimetres(after[name])} for name in before
        },
        "girth_scales": {name: round(float(scale), 4) for name, scale in zip(GIRTHS, girths, strict=True)},
        "detector_offsets_cm": {name: [centimetres(v) for v in offset] for name, offset in fit.offsets.items()},
        "keypoint_error_cm": {"generic": centimetres(fit.generic_error), "fitted": centimetres(fit.keypoint_error)},
    }


def _table(record: dict[str, Any], out: Path) -> Table:
    source = f"{record['masks']} masks" if record["masks"] else "no masks: girths follow the lengths"
    error = record["keypoint_error_cm"]
    table = Table(
        title=f"{out}: fitted at frames {', '.join(map(str, record['frames']))}; {source}",
        title_justify="left",
        caption=f"keypoints off by {error['fitted']:.1f} cm in the median, {error['generic']:.1f} cm before",
    )
    for column in ("Bone", "generic, cm", "fitted, cm", "length", "girth"):
        table.add_column(column, justify="left" if column == "Bone" else "right")
    for name, bone in record["bones_cm"].items():
        girth = record["girth_scales"].get(name)
        change = 100 * (bone["fitted"] / bone["generic"] - 1)
        table.add_row(
            name.replace("_", " "),
            f"{bone['generic']:.1f}",
            f"{bone['fitted']:.1f}",
            f"{change:+.1f} %",
            "" if girth is None else f"{100 * (girth - 1):+.1f} %",
        )
    return table
