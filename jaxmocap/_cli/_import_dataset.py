"""`jaxmocap import-dataset`: a sequence of a public data set as a capture."""

from pathlib import Path
from typing import Annotated, Literal

import tyro

from jaxmocap._results import InputError

from ._arguments import Json
from ._output import say, show


def import_dataset(
    dataset: Annotated[
        Literal["humaneva-1", "humaneva-2", "tnt15", "biocv", "movi", "opencap"],
        tyro.conf.Positional,
        tyro.conf.arg(help="Which data set."),
    ],
    folder: Annotated[
        Path, tyro.conf.Positional, tyro.conf.arg(metavar="FOLDER", help="Where you put it; it is not downloaded.")
    ],
    out: Annotated[Path, tyro.conf.arg(metavar="DIR", help="New capture folder.")],
    sequence: Annotated[
        str | None,
        tyro.conf.arg(metavar="NAME", help="Such as S1/Walking_1.", help_behavior_hint="(default: the only one)"),
    ] = None,
    cameras: Annotated[
        tuple[str, ...],
        tyro.conf.arg(metavar="NAME ...", help="Cameras to take.", help_behavior_hint="(default: the paper's, or all)"),
    ] = (),
    frames: Annotated[
        str | None,
        tyro.conf.arg(
            metavar="A:B",
            help="Only frames A to B - 1 of the sequence, counted from 0.",
            help_behavior_hint="(default: all)",
        ),
    ] = None,
    json: Json = False,
) -> int:
    """Make a capture of one sequence of HumanEva I or II, TNT15, BioCV, MoVi or OpenCap."""
    from jaxmocap.capture import Capture
    from jaxmocap.datasets import import_dataset

    made = import_dataset(
        dataset, folder, out, sequence=sequence, cameras=cameras or None, frames=_span(frames), say=say
    )
    capture = Capture.open(made)
    found = {"capture": str(made), "frames": capture.num_frames, "cameras": list(capture.camera_names)}
    show(found, lambda: f"{made}: {capture.num_frames} frames of {', '.join(capture.camera_names)}", json_wanted=json)
    return 0


def _span(text: str | None) -> tuple[int, int] | None:
    if text is None:
        return None
    start, colon, stop = text.partition(":")
    if not (colon and start.isdigit() and stop.isdigit() and int(start) < int(stop)):
        raise InputError(f"--frames is {text!r}; A:B with A < B was expected, such as 0:200.")
    return int(start), int(stop)
