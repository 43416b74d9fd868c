"""`jaxmocap view`: a result in three dimensions."""

from pathlib import Path
from typing import Annotated

import tyro

from jaxmocap._results import InputError

from ._output import say

_LOOPBACK = ("127.0.0.1", "localhost", "::1")


def view(
    result: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR", help="Folder that track wrote.")],
    other: Annotated[
        Path | None,
        tyro.conf.arg(
            name="with", metavar="DIR", help="A second result, over the first or beside it.", help_behavior_hint=""
        ),
    ] = None,
    truth: Annotated[
        Path | None,
        tyro.conf.arg(
            metavar="truth.npz",
            help="True markers or joints.",
            help_behavior_hint="(default: the truth of the tracked capture)",
        ),
    ] = None,
    capture: Annotated[
        Path | None,
        tyro.conf.arg(
            metavar="CAPTURE", help="Where the images are.", help_behavior_hint="(default: the tracked capture)"
        ),
    ] = None,
    host: Annotated[
        str,
        tyro.conf.arg(
            metavar="ADDRESS", help="Address of this machine to serve at: 0.0.0.0 lets in the whole network."
        ),
    ] = "127.0.0.1",
    port: Annotated[int, tyro.conf.arg(metavar="N", help="First port to try.")] = 8080,
    movie: Annotated[
        Path | None,
        tyro.conf.arg(
            metavar="FILE",
            help="Write FILE.mp4, a turn round the person as the clip plays, or FILE.png, the first view.",
            help_behavior_hint="",
        ),
    ] = None,
    rerun: Annotated[
        Path | None,
        tyro.conf.arg(metavar="FILE.rrd", help="Write a recording for Rerun and show nothing.", help_behavior_hint=""),
    ] = None,
) -> int:
    """Show a result in the browser: mesh, skeleton, cameras with images, curves, truth, a second result."""
    from jaxmocap.viewers import view, write_movie, write_rerun

    if not 0 <= port <= 65535:
        raise InputError(f"--port is {port}; a number from 0 to 65535 was expected, such as 8080.")
    if movie is not None:
        say(f"{write_movie(result, movie, other=other, capture=capture)}")
        return 0
    if rerun is not None:
        path, missing = write_rerun(result, rerun, other=other, truth=truth, capture=capture)
        for sentence in missing:
            say(sentence)
        say(f"{path}: open it with rerun {path}")
        return 0
    viewer = view(result, other=other, truth=truth, capture=capture, host=host, port=port)
    for sentence in viewer.missing:
        say(sentence)
    if host not in _LOOPBACK:
        say(f"Whoever reaches {host} sees the images of this capture.")
    say(f"Open {viewer.url} in a browser; Ctrl-C ends it.")
    viewer.wait()
    return 0
