"""`jaxmocap bench`: methods and settings compared."""

from pathlib import Path
from typing import Annotated, Literal

import tyro

from jaxmocap._results import InputError

from ._arguments import FrameSpan, Json, Scheduler, Workers, frame_span
from ._output import progress, say, show

WORSE = 1


def bench(
    what: Annotated[Literal["paper"], tyro.conf.Positional, tyro.conf.arg(help="Section 5 of the paper.")],
    out: Annotated[Path, tyro.conf.arg(metavar="DIR", help="Folder for runs, table and report; goes on where it was.")],
    quick: Annotated[
        bool,
        tyro.conf.arg(
            help="One seed, preset draft and, without --capture, small captures: a quarter of an hour.",
            help_behavior_hint="",
        ),
    ] = False,
    capture: Annotated[
        tuple[Path, ...],
        tyro.conf.arg(
            metavar="DIR ...",
            help="Compare the methods on these captures, which must have a truth, instead of the synthetic suite.",
            help_behavior_hint="",
        ),
    ] = (),
    methods: Annotated[
        tuple[str, ...],
        tyro.conf.arg(
            metavar="NAME ...",
            help="ours, local, annealed-particle-filter, cma-es, keypoints, keypoint-fit, hasler-1, hasler-5, posecut, "
            "sums-of-gaussians, flow, differentiable-rendering, differentiable-visibility.",
            help_behavior_hint="(default: all)",
        ),
    ] = (),
    frames: FrameSpan = None,
    quality: Annotated[
        Literal["draft", "normal", "paper"] | None,
        tyro.conf.arg(
            metavar="{draft,normal,paper}",
            help="Preset of the methods that have one.",
            help_behavior_hint="(default: normal, quick: draft)",
        ),
    ] = None,
    seeds: Annotated[
        tuple[int, ...], tyro.conf.arg(metavar="N ...", help="Seeds.", help_behavior_hint="(default: 0 1 2, quick: 0)")
    ] = (),
    only: Annotated[
        str | None,
        tyro.conf.arg(metavar="REGEX", help="Only experiments that match.", help_behavior_hint="(default: all)"),
    ] = None,
    gate: Annotated[
        Path | None,
        tyro.conf.arg(
            metavar="figures.json", help="Exit with 1 if a figure is worse than in this file.", help_behavior_hint=""
        ),
    ] = None,
    workers: Workers = None,
    scheduler: Scheduler = None,
    retry_failed: Annotated[bool, tyro.conf.arg(help_behavior_hint="", help="Do runs again that failed.")] = False,
    json: Json = False,
) -> int:
    """Compare the tracker with its competitors and with parts left out. Exits with 1 if --gate finds a regression."""
    from jaxmocap.capture import Capture
    from jaxmocap.experiments import bench, summary_lines

    if frames is not None and not capture:
        raise InputError("--frames is for --capture; the synthetic suite has its own frames.")
    span = frame_span(frames, min(Capture.open(folder).num_frames for folder in capture)) if frames else None
    with progress() as report:
        result = bench(
            what,
            out,
            quick=quick,
            captures=capture,
            methods=methods or None,
            frames=span,
            quality=quality,
            seeds=seeds or None,
            only=only,
            gate=gate,
            workers=workers,
            scheduler=scheduler,
            retry_failed=retry_failed,
            progress=report,
        )
    found = summary_lines(result)
    show(found, lambda: result.files["markdown"].read_text(), json_wanted=json)
    for key, error in found["failures"].items():
        say(f"{key} failed: {error}")
    for complaint in result.complaints:
        say(f"Worse than {gate}: {complaint}")
    say(f"Look at {result.files['report']}.")
    return WORSE if result.complaints else 0
