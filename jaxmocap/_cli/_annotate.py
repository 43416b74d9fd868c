"""`jaxmocap annotate`: keypoints set by hand, or a detector's corrected, in the browser."""

import contextlib
import re
import webbrowser
from typing import Annotated

import tyro

from jaxmocap._results import InputError

from ._arguments import CapturePath
from ._output import say


def annotate(
    capture: CapturePath,
    frames: Annotated[
        tuple[str, ...],
        tyro.conf.arg(
            metavar="N ...",
            help="Frames to begin with, counted from 0, such as 0 45 or 10:13; the page goes to any other.",
            help_behavior_hint="(default: the selected frames)",
        ),
    ] = (),
    cameras: Annotated[
        tuple[str, ...],
        tyro.conf.arg(
            metavar="NAME ...", help="Views to show at first, such as cam0 cam1.", help_behavior_hint="(default: all)"
        ),
    ] = (),
    port: Annotated[int, tyro.conf.arg(metavar="N", help="First port to try.")] = 8070,
    no_browser: Annotated[bool, tyro.conf.arg(help="Only print the address.", help_behavior_hint="")] = False,
) -> int:
    """Set keypoints by hand on a page for this machine alone, or correct a detector's; saved at once in the capture."""
    from jaxmocap.annotation import annotate
    from jaxmocap.capture import Capture

    numbers = None if not frames else [number for text in frames for number in _numbers(text)]
    page = annotate(capture, frames=numbers, cameras=cameras or None, port=port)
    try:
        say(
            f"Open {page.url} in a browser; its button Finish or Ctrl-C here ends it. Points are saved as they are set."
        )
        if not no_browser:
            webbrowser.open(page.url)
        with contextlib.suppress(KeyboardInterrupt):
            page.wait()
    finally:
        page.stop()
    folder = Capture.open(capture).keypoints_folder
    count = len(page.written)
    say(f"{count} file{'s' * (count != 1)} in {folder}." if count else "Nothing was changed.")
    return 0


def _numbers(text: str) -> range:
    """`12` or `10:13`."""
    found = re.fullmatch(r"(\d{1,9})(?::(\d{1,9}))?", text)
    if found is None or (found[2] and int(found[2]) <= int(found[1])):
        raise InputError(f"--frames has {text!r}; whole numbers were expected, such as 0 45, or A:B with A < B.")
    start = int(found[1])
    return range(start, int(found[2]) if found[2] else start + 1)
