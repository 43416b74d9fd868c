"""When videos began by the person's keypoints, where neither flash, sound nor motion of the pictures tells."""

from pathlib import Path

import numpy as np

from jaxmocap._files import write_text
from jaxmocap.capture import (
    KEYPOINT_NAMES,
    Capture,
    PersonHeights,
    PersonOffset,
    config_path,
    offset_by_person,
    with_offsets,
)
from jaxmocap.detection import best_person

_POINTS = [
    KEYPOINT_NAMES.index(name)
    for name in ("nose", *(f"{side}_{part}" for part in ("elbow", "wrist", "knee", "ankle") for side in "lr"))
]
_SHOULDERS, _HIPS = ([KEYPOINT_NAMES.index(f"{side}_{part}") for side in "lr"] for part in ("shoulder", "hip"))
_CONFIDENT = 0.3


def sync_by_person(path: str | Path) -> list[PersonOffset] | None:
    """Find `offset` of every camera but the first from the capture's keypoints, and write it into `capture.toml`.

    None, with nothing written, where the keypoints are not sure.
    """
    file = config_path(path)
    capture = Capture.open(file, with_cameras=False)
    seen = [person_heights(capture, camera) for camera in range(capture.num_cameras)]
    found = [offset_by_person(seen[0], other) for other in seen[1:]]
    sure = [one for one in found if one is not None and one.sure]
    if len(sure) < len(found):
        return None
    offsets = [0.0, *(one.seconds for one in sure)]
    write_text(file, with_offsets(file.read_bytes().decode("utf-8"), offsets, file))
    return sure


def person_heights(capture: Capture, camera: int) -> PersonHeights:
    """Read how high points of the person are in every picture of a video that has keypoints."""
    source, index = capture.video_keypoints(camera), capture.indices[camera]
    frames = [] if source is None else [frame for frame in range(index.num_frames) if source.has(frame)]
    rows = [_heights(best_person(source.people(frame))) for frame in frames] if source is not None else []
    return PersonHeights(index.seconds[frames], np.array(rows).reshape(len(frames), len(_POINTS)))


def _heights(person: np.ndarray | None) -> np.ndarray:
    if person is None or (person[_SHOULDERS + _HIPS, 2] < _CONFIDENT).any():
        return np.full(len(_POINTS), np.nan)
    hips = person[_HIPS, :2].mean(0)
    trunk = max(float(np.linalg.norm(person[_SHOULDERS, :2].mean(0) - hips)), 1.0)
    return np.where(person[_POINTS, 2] >= _CONFIDENT, (hips[1] - person[_POINTS, 1]) / trunk, np.nan)
