"""`jaxmocap scan`: a walk around a standing person, or pictures from all around, become an actor."""

from pathlib import Path
from typing import Annotated

import tyro

from jaxmocap._results import InputError

from ._arguments import Json, Seed, Weights
from ._output import progress, say, show, write_png
from ._rig import refuse_unusable

Pixel = tuple[float, float]


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
            help="How tall the person is; needed but where a length is known, or masks and cameras in metres are "
            "given.",
            help_behavior_hint="(default: the cameras are in metres)",
        ),
    ] = None,
    known_length: Annotated[
        tuple[str, ...],
        tyro.conf.arg(
            metavar="METRES PICTURE:X,Y:X,Y ...",
            help="Instead of the height: the length of a door or a stick, and the pixels of its two ends, the same end "
            "first, in two or more pictures (names without ending) of the folder, or of that which --keep-views wrote.",
            help_behavior_hint="",
        ),
    ] = (),
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
            known_length=_known_length(known_length),
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


def _known_length(texts: tuple[str, ...]) -> tuple[float, dict[str, tuple[Pixel, Pixel]]] | None:
    """Read `--known-length METRES PICTURE:X,Y:X,Y ...` as metres and two pixels by picture; None without it."""
    if not texts:
        return None
    found: dict[str, tuple[Pixel, Pixel]] = {}
    for text in texts[1:]:
        name, first, second = [*text.rsplit(":", 2), "", ""][:3]
        if name in found:
            raise InputError(f"--known-length marks {name} twice; give every picture once.")
        found[name] = _pixel(first, text), _pixel(second, text)
    try:
        return float(texts[0]), found
    except ValueError:
        raise InputError(_expected(texts[0])) from None


def _pixel(part: str, text: str) -> Pixel:
    try:
        x, y = map(float, part.split(","))
    except ValueError:
        raise InputError(_expected(text)) from None
    return x, y


def _expected(text: str) -> str:
    return (
        f"--known-length has {text!r}; METRES PICTURE:X,Y:X,Y PICTURE:X,Y:X,Y was expected, such as 2.03 "
        "view03:410,95:422,871 view07:388,102:391,880."
    )
