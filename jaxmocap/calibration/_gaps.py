"""Spans of frames that could not be placed: short ones are filled in, long ones are a cut, or nothing to go by."""

import numpy as np

from jaxmocap._results import InputError
from jaxmocap.capture import Capture

_LONGEST = 1.0  # seconds: a hand moves too much for longer ones to be filled in
_LARGEST_SHARE = 0.2


def refuse_gaps(capture: Capture, interpolated: set[tuple[int, int]]) -> None:
    """`interpolated` are (camera, frame of its own video). Raises `InputError` where a camera has a second or more of
    them on end among the shared frames, or more than a fifth."""
    for camera, name in enumerate(capture.camera_names):
        own = capture.video_frames[camera]
        filled = np.array([(camera, int(frame)) in interpolated for frame in own])
        edges = np.flatnonzero(np.diff(np.concatenate([[0], filled.astype(int), [0]])))
        runs = [(int(start), int(stop)) for start, stop in edges.reshape(-1, 2)]
        if not runs:
            continue
        start, stop = max(runs, key=lambda run: run[1] - run[0])
        if stop - start < _LONGEST * capture.fps and filled.mean() <= _LARGEST_SHARE:
            continue
        raise InputError(
            f"camera '{name}' cannot be placed in {int(filled.sum())} of {len(own)} shared frames, at most at frames "
            f"{own[start]} to {own[stop - 1]} on end: they show another place (a cut?), or too little background; cut "
            "that part off both videos, or film it again."
        )
