"""`jaxmocap demo`: a capture made from nothing, tracked and scored."""

import contextlib
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from jaxmocap._results import InputError

from ._arguments import Json, Seed
from ._output import progress, say, show, write_png
from ._register import refuse_if_taken
from ._track import report_trust, summary

if TYPE_CHECKING:
    import numpy as np

    from jaxmocap.motion import Motion

_SIZE = (480, 270)
_SHEET_ROWS = 4


def demo(
    out: Annotated[Path, tyro.conf.arg(metavar="DIR", help="New folder for the capture and the result.")] = Path(
        "demo"
    ),
    frames: Annotated[int, tyro.conf.arg(metavar="N", help="Frames to film and to track.")] = 10,
    seed: Seed = 0,
    json: Json = False,
) -> int:
    """Film a synthetic dancer with two handheld cameras, track, and compare with the truth. Needs no data."""
    from jaxmocap.metrics import evaluate, evaluation_table
    from jaxmocap.pipeline import track_capture
    from jaxmocap.synthetic import make_capture, write_capture

    if frames < 2:
        raise InputError(f"--frames is {frames}; at least 2 are needed.")
    refuse_if_taken(out)
    capture, result = out / "capture", out / "result"
    with _removed_if_unfinished(out), progress() as report:
        report("film", 0, 1)
        write_capture(make_capture(frames, _SIZE, seed=seed), capture)
        report("film", 1, 1)
        motion = track_capture(capture, result, seed=seed, progress=report)
        write_png(out / "contact_sheet.png", contact_sheet_of(capture, motion))
    scores = evaluate(motion, capture / "truth.npz")
    show(
        {"out": out, **summary(motion), **scores},
        lambda: evaluation_table(scores, "Demo against its truth"),
        json_wanted=json,
    )
    say(f"Look at {out / 'contact_sheet.png'}, and open {result / 'report.html'} in a browser.")
    return report_trust(motion)


def contact_sheet_of(path: Path, motion: "Motion") -> "np.ndarray":
    """Draw the tracked body over a few frames, one row per frame and one column per camera."""
    import numpy as np

    from jaxmocap.capture import Capture
    from jaxmocap.viewers import contact_sheet, overlay_frames

    capture = Capture.open(path)
    picked = motion[np.unique(np.linspace(0, len(motion) - 1, _SHEET_ROWS).astype(int))]
    views = [
        [image for _, image in overlay_frames(capture, capture.cameras, motion.character, picked, camera)]
        for camera in range(capture.num_cameras)
    ]
    return contact_sheet([image for row in zip(*views, strict=True) for image in row], capture.num_cameras)


@contextlib.contextmanager
def _removed_if_unfinished(out: Path) -> Iterator[None]:
    try:
        yield
    except BaseException:
        shutil.rmtree(out, ignore_errors=True)
        raise
