"""Compile ahead of the first film what tracking runs."""

import tempfile
import time
from pathlib import Path

from jaxmocap.synthetic import make_capture, write_capture

from ._track_capture import track_capture

FRAMES = 6
"""As many as it takes until a frame brings no new program."""

SIZE = (960, 540)
"""What the pictures of most phones are made to."""


def warm_up(num_cameras: int = 2) -> float:
    """Compile what tracking `num_cameras` films runs, and keep it; return the seconds that took.

    A synthetic capture is tracked with keypoints, as `run` does. Another capture then finds nearly all its programs, as
    long as it is as large, the person fills no more than its shorter side, and the mesh has about as many faces as the
    built-in body.
    """
    begin = time.perf_counter()
    with tempfile.TemporaryDirectory() as name:
        film = write_capture(make_capture(FRAMES, SIZE, num_cameras), Path(name) / "film")
        track_capture(film, Path(name) / "result", detections=film / "keypoints", overlays=False, cache=False)
    return time.perf_counter() - begin
