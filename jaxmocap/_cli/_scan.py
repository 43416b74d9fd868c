"""`jaxmocap scan`: a walk around a standing person, or pictures from all around, become an actor."""

from pathlib import Path
from typing import Annotated

import tyro

from jaxmocap._results import InputError

from ._arguments import Json, Seed, Weights
from ._output import progress, say, show, write_png
from ._rig import refuse_unusable


def scan(
    pictures: Annotated[
        Path,
        tyro.conf.Positional,
        tyro.conf.arg(
            metavar="VIDEO|DIR",
            help="A video once around a person who stands still, a folder of pictures from all around, JPEG or PNG, or "
            "what --keep-views wrote.",
        ),
    ],
    out: Annotated[Path, tyro.conf.arg(metavar="FILE.glb", help="New file for the actor.")],
    cameras: Annotated[
        Path | None,
        tyro.conf.arg(
            metavar="PATH",
            help="The pictures' cameras: a COLMAP model whose images have the pictures' names, or a calibration of "
            "static cameras with these names.",
            help_behavior_hint="(default: found, by what the pictures show)",
        ),
    ] = None,
    masks: Annotated[
        Path | None,
        tyro.conf.arg(
            metavar="DIR",
            help="The person in each picture, white, PNG files of the pictures' names.",
            help_behavior_hint="(default: found, by a detector and the built-in body)",
        ),
    ] = None,
    keep_views: Annotated[
        Path | None,
        tyro.conf.arg(
            metavar="DIR",
            help="New folder for pictures, masks and how sure each is; correct masks and give it instead of the video.",
            help_behavior_hint="",
        ),
    ] = None,
    triangles: Annotated[int, tyro.conf.arg(metavar="N", help="Triangles of the actor, about.")] = 5000,
    height: Annotated[
        float | None,
        tyro.conf.arg(
            metavar="METRES",
            help="How tall the person is; needed but where masks and cameras in metres are given.",
            help_behavior_hint="(default: the cameras are in metres)",
        ),
    ] = None,
    focal: Annotated[
        float | None,
        tyro.conf.arg(
            metavar="PIXELS", help="Focal length of the pictures, if known.", help_behavior_hint="(default: found)"
        ),
    ] = None,
    weights: Weights = None,
    seed: Seed = 0,
    picture: Annotated[
        Path | None,
        tyro.conf.arg(
            metavar="FILE.png",
            help="Draw the actor with its joints, and bent at elbows, shoulders, knees and hips.",
            help_behavior_hint="",
        ),
    ] = None,
    json: Json = False,
) -> int:
    """Scan a standing person from a walk around or pictures, for `--actor` or capture.toml."""
    refuse_unusable(out)
    if picture is not None and picture.suffix.lower() != ".png":
        raise InputError(f"--picture is {picture}; a file name that ends in .png was expected.")

    from jaxmocap.pipeline import scan as scan_pictures

    with progress() as report:
        made = scan_pictures(
            pictures,
            out,
            cameras=cameras,
            masks=masks,
            height=height,
            keep_views=keep_views,
            focal=focal,
            weights=weights,
            num_faces=triangles,
            seed=seed,
            say=say,
            progress=report,
        )
    if picture is not None:
        from jaxmocap.viewers import draw_character

        write_png(picture, draw_character(made.rigged.character, made.colours))
    overlap = made.report["overlap"].values()
    text = (
        f"{out}: {made.report['height_m']:.2f} m tall, from {made.report['views'] - len(made.report['left_out'])} "
        f"views; its silhouette overlaps the masks by {sum(overlap) / len(overlap):.3f}."
    )
    show({"out": out, **made.report}, lambda: text, json_wanted=json)
    for warning in made.report["warnings"]:
        say(f"{out}: {warning}.")
    return 0
