"""`jaxmocap calibrate`: the cameras of a capture from its videos."""

from pathlib import Path
from typing import Annotated, Any

import tyro
from rich.table import Table

from jaxmocap._results import InputError

from ._arguments import CaptureOrVideos, FrameSpan, Json, NewCapture, Seed, named_numbers, open_span
from ._output import progress, say, show


def calibrate(
    capture: CaptureOrVideos,
    out: NewCapture = None,
    height: Annotated[
        float | None,
        tyro.conf.arg(
            metavar="METRES",
            help="The person's height, which tells the scale together with keypoints in the capture.",
            help_behavior_hint="(default: the actor's bones)",
        ),
    ] = None,
    camera_distance: Annotated[
        float | None,
        tyro.conf.arg(
            metavar="METRES",
            help="Metres between the first two cameras at their first shared frame, instead of the person's size.",
            help_behavior_hint="",
        ),
    ] = None,
    up: Annotated[
        tuple[str, ...],
        tyro.conf.arg(
            metavar="X Y Z",
            help="Up as the first camera sees it at the first shared frame: x right, y down, z forward; or a letter, "
            "such as --up x where the phone lay on its left side, --up=-y where it stood upright.",
            help_behavior_hint="(default: from ground and cameras)",
        ),
    ] = (),
    focal: Annotated[
        tuple[str, ...],
        tyro.conf.arg(
            metavar="CAMERA=PIXELS ...",
            help="Focal lengths to keep, such as cam0=1450 cam1=1450.",
            help_behavior_hint="(default: found)",
        ),
    ] = (),
    intrinsics: Annotated[
        Path | None,
        tyro.conf.arg(
            metavar="FILE",
            help="Calibration whose lenses are kept, of cameras that stand still; its poses do not count.",
            help_behavior_hint="(default: found)",
        ),
    ] = None,
    static: Annotated[
        bool,
        tyro.conf.arg(
            help="All cameras stand still: place them by the person's keypoints, whatever the background says.",
            help_behavior_hint="(default: told by the background)",
        ),
    ] = False,
    frames: FrameSpan = None,
    keep_offsets: Annotated[
        bool,
        tyro.conf.arg(
            help="Leave offset in capture.toml as it is.",
            help_behavior_hint="(default: set where the person's motion tells it)",
        ),
    ] = False,
    key_step: Annotated[int, tyro.conf.arg(metavar="N", help="One key frame in so many frames.")] = 5,
    replace: Annotated[
        bool,
        tyro.conf.arg(help="Calibrate though capture.toml names cameras; they are kept.", help_behavior_hint=""),
    ] = False,
    seed: Seed = 0,
    json: Json = False,
) -> int:
    """Find the poses and lenses of cameras from their videos, and complete capture.toml.

    Cameras that move are found by the background, cameras that stand still by the person's keypoints at all frames. A
    list of videos with --out is synchronised first, and becomes a new capture; --camera-distance tells its scale, since
    videos alone have no keypoints."""
    from jaxmocap.pipeline import calibrate

    lengths = named_numbers(focal, "--focal", "CAMERA=PIXELS", "cam0=1450")
    with progress() as report:
        calibration = calibrate(
            capture,
            out,
            replace=replace,
            height=height,
            camera_distance=camera_distance,
            up=_direction(up),
            focal=lengths,
            intrinsics=intrinsics,
            static=static or None,
            frames=open_span(frames),
            keep_offsets=keep_offsets,
            key_step=key_step,
            seed=seed,
            say=say,
            progress=report,
        )
    folder = calibration.folder
    assert folder is not None
    show({"folder": folder, **calibration.record}, lambda: _table(calibration.record, folder), json_wanted=json)
    return 0


def _direction(texts: tuple[str, ...]) -> tuple[float, float, float] | None:
    """Read `--up`: three numbers, or an axis by its letter."""
    if not texts:
        return None
    if len(texts) == 1 and texts[0].lstrip("+-").lower() in ("x", "y", "z"):
        sign = -1.0 if texts[0].startswith("-") else 1.0
        x, y, z = (sign if texts[0][-1].lower() == axis else 0.0 for axis in "xyz")
        return x, y, z
    try:
        x, y, z = (float(text) for text in texts)
    except ValueError:
        raise InputError(
            f"--up is {' '.join(texts)!r}; three numbers were expected (x right, y down, z forward), or x, -y and so on"
        ) from None
    return x, y, z


def _table(record: dict[str, Any], folder: Path) -> Table:
    scale, gravity = record["scale"], record["gravity"]
    sentences = [
        f"Scale from the {scale['from']} (standard deviation {100 * scale['relative_deviation']:.1f} %), up from the "
        f"{gravity['from']}; {record['seconds']:.0f} s.",
        record["person"]["sentence"][0].upper() + record["person"]["sentence"][1:],
        *(f"Warning: {warning}." for warning in record["warnings"]),
    ]
    caption = "\n".join(["Focal lengths and residuals in pixels; ± are standard deviations.", *sentences])
    table = Table(title=str(folder), title_justify="left", caption=caption, caption_justify="left")
    for column in ("Camera", "Frames", "Repaired", "Filled in", "Focal", "Residual", "± cm", "± deg"):
        table.add_column(column, justify="left" if column == "Camera" else "right")
    for name, camera in record["cameras"].items():
        table.add_row(
            name,
            f"{camera['frames'][0]}-{camera['frames'][1]}",
            str(len(camera["placed_again"])),
            str(len(camera["interpolated"])),
            f"{camera['focal_pixels']:.1f}",
            f"{camera['median_residual_pixels']:.2f}",
            f"{100 * camera['centre_deviation_m']:.2f}",
            f"{camera['rotation_deviation_degrees']:.3f}",
        )
    return table
