"""`jaxmocap batch`: many takes, one table and one page."""

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from rich.table import Table

from ._arguments import (
    ActorFile,
    FrameSpan,
    Height,
    Json,
    Preset,
    Scheduler,
    Seed,
    Settings,
    Workers,
    named_settings,
    open_span,
)
from ._output import progress, say, show
from ._track import NOT_TRUSTED

if TYPE_CHECKING:
    from jaxmocap.pipeline import Batch

OUR_ERROR, THEIR_INPUT = 1, 2


def batch(
    takes: Annotated[
        tuple[Path, ...],
        tyro.conf.Positional,
        tyro.conf.arg(
            metavar="TAKE ...",
            help="Capture folders, or a takes.toml that lists captures and videos.",
            help_behavior_hint="",
        ),
    ],
    out: Annotated[
        Path, tyro.conf.arg(metavar="DIR", help="Folder with a result folder per take; an earlier batch in it goes on.")
    ],
    frames: FrameSpan = None,
    seed: Seed = 0,
    quality: Preset = "normal",
    settings: Settings = (),
    actor: ActorFile = None,
    height: Height = None,
    workers: Workers = None,
    scheduler: Scheduler = None,
    json: Json = False,
) -> int:
    """Track many takes; what is finished is kept, what was cut off goes on, what fails stops no other.

    DIR/index.html shows every take's verdict. Exits with 3 if not every frame of every take is to be trusted, with 2
    if a take has no result because of its input, and with 1 if one has none because of an error of jaxmocap."""
    from jaxmocap.pipeline import batch

    with progress() as report:
        result = batch(
            takes,
            out,
            quality=quality,
            seed=seed,
            frames=open_span(frames) or (0, None),
            settings=named_settings(settings),
            actor=actor,
            height=height,
            workers=workers,
            scheduler=scheduler,
            say=say,
            progress=report,
        )
    record = {"out": out, "index": result.index, "headline": result.headline}
    show(record | {"takes": list(map(asdict, result.takes))}, lambda: _table(result), json_wanted=json)
    if result.failed:
        return OUR_ERROR if any(take.traceback for take in result.failed) else THEIR_INPUT
    return 0 if all(take.trusted for take in result.takes) else NOT_TRUSTED


def _table(result: "Batch") -> Table:
    caption = f"{result.headline}\nOpen {result.index}"
    table = Table(title_justify="left", caption=caption, caption_justify="left", min_width=40)
    for column in ("Take", "", "Verdict"):
        table.add_column(column)
    for column in ("trusted", "seconds", "markers cm", "joints cm"):
        table.add_column(column, justify="right")
    for take in result.takes:
        trusted = f"{take.trusted_frames}/{take.frames}" if take.frames else ""
        figures = (
            "" if value is None else f"{value:.{digits}f}"
            for value, digits in ((take.seconds, 0), (take.marker_error_cm, 2), (take.joint_error_cm, 2))
        )
        table.add_row(take.name, take.way, take.verdict, trusted, *figures)
    return table
