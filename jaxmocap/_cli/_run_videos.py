"""`jaxmocap run`: videos in, a motion out."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from rich.console import Group
from rich.table import Table
from rich.text import Text

from ._arguments import Json, Preset, Seed, Weights, named_numbers, open_span, person_pixels
from ._output import progress, say, show
from ._track import counted, report_trust, summary

if TYPE_CHECKING:
    from jaxmocap.pipeline import PlannedStage


def run_videos(
    videos: Annotated[
        tuple[Path, ...],
        tyro.conf.Positional,
        tyro.conf.arg(
            metavar="VIDEO ...", help="Two or three videos of the same moment; or one.", help_behavior_hint=""
        ),
    ],
    out: Annotated[Path, tyro.conf.arg(metavar="DIR", help="New folder for everything; an earlier run in it goes on.")],
    height: Annotated[
        float | None,
        tyro.conf.arg(metavar="METRES", help="How tall the person is, which tells the scale.", help_behavior_hint=""),
    ] = None,
    camera_distance: Annotated[
        float | None,
        tyro.conf.arg(
            metavar="METRES",
            help="Metres between the first two cameras at their first shared frame, instead of the person's height.",
            help_behavior_hint="",
        ),
    ] = None,
    focal: Annotated[
        tuple[str, ...],
        tyro.conf.arg(
            metavar="CAMERA=PIXELS ...",
            help="Focal lengths to keep; a camera is called like its video.",
            help_behavior_hint="(default: found)",
        ),
    ] = (),
    offset: Annotated[
        tuple[str, ...],
        tyro.conf.arg(
            metavar="CAMERA=SECONDS ...",
            help="Seconds to add to a video's own time where it began earlier or later; 0 for the others.",
            help_behavior_hint="(default: found)",
        ),
    ] = (),
    frames: Annotated[
        str | None,
        tyro.conf.arg(
            metavar="A:B",
            help="Track only frames A to B - 1 of those the videos share; either may be left out.",
            help_behavior_hint="(default: all)",
        ),
    ] = None,
    quality: Preset = "normal",
    actor: Annotated[
        Path | None,
        tyro.conf.arg(
            metavar="FILE",
            help="Scan of the person (OBJ, PLY, GLB), or a character.",
            help_behavior_hint="(default: a body is made to measure)",
        ),
    ] = None,
    scan: Annotated[
        Path | None,
        tyro.conf.arg(
            metavar="VIDEO|DIR",
            help="A video once around the person, who stands still, pictures, or what `scan --keep-views` wrote: the "
            "actor is made of it.",
            help_behavior_hint="",
        ),
    ] = None,
    person: Annotated[
        tuple[str, ...],
        tyro.conf.arg(
            metavar="CAMERA=X,Y ...",
            help="Pixel on the person in the first picture that all videos share, where several are seen.",
            help_behavior_hint="(default: the largest)",
        ),
    ] = (),
    weights: Weights = None,
    keypoints: Annotated[
        Path | None,
        tyro.conf.arg(
            metavar="DIR",
            help="Keypoints of another detector, instead of looking for the person.",
            help_behavior_hint="",
        ),
    ] = None,
    static: Annotated[
        bool, tyro.conf.arg(help="The cameras stand on tripods.", help_behavior_hint="(default: told by the videos)")
    ] = False,
    detections: Annotated[
        bool, tyro.conf.arg(help="Track by the pixels alone, not by keypoints too.", help_behavior_hint="")
    ] = True,
    seed: Seed = 0,
    json: Json = False,
) -> int:
    """Make a motion of videos: synchronise, find the person, calibrate, make a body to measure, track, report.

    What every stage makes is kept in DIR/capture, to be looked at and corrected; the same command goes on from the
    first stage whose inputs changed. Exits with 3 if not every frame is to be trusted."""
    from jaxmocap.pipeline import run

    with progress() as report:
        result = run(
            videos,
            out,
            height=height,
            camera_distance=camera_distance,
            focal=named_numbers(focal, "--focal", "CAMERA=PIXELS", "cam0=1450"),
            offset=named_numbers(offset, "--offset", "CAMERA=SECONDS", "cam0=-0.4"),
            frames=open_span(frames) or (0, None),
            quality=quality,
            actor=actor,
            scan=scan,
            person=person_pixels(person),
            weights=weights,
            keypoints=keypoints,
            static=static,
            detections=detections,
            seed=seed,
            plan=lambda planned: say_plan(planned, out),
            say=say,
            progress=report,
        )
    found = summary(result.motion)
    record = {"out": out, "capture": result.capture, "result": result.folder, "report": result.report, **found}
    seconds = {name: round(took, 1) for name, took in result.seconds.items()}
    show({**record, "seconds": seconds}, lambda: _table(seconds, found, result.report), json_wanted=json)
    return report_trust(result.motion)


def say_plan(planned: "list[PlannedStage]", out: Path) -> None:
    """Tell what will be done, stage by stage."""
    say(f"{out}:")
    for number, stage in enumerate(planned, 1):
        say(f"  {number}. {stage}")


def _table(seconds: dict[str, float], found: dict[str, float], report: Path) -> Group:
    table = Table(min_width=40)
    table.add_column("Stage")
    table.add_column("seconds", justify="right")
    for name, took in seconds.items():
        table.add_row(name, f"{took:.0f}")
    return Group(table, Text(f"{counted(found)}.\nOpen {report}", no_wrap=True, overflow="ignore"))
