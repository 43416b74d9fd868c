"""What is known of static cameras before they are found: the person's keypoints at all frames, lenses, bones."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from jaxmocap._results import InputError
from jaxmocap.camera import read_cameras
from jaxmocap.capture import Capture, Undistortion

from ._footage import CONFIDENT, Footage

_MOST_FRAMES = 2400  # that count: of longer captures every so many


def known_lenses(capture: Capture, footage: Footage, file: Path | None) -> tuple[np.ndarray, np.ndarray]:
    """Read the cameras' matrices (camera, 3, 3) and five coefficients of distortion (camera, 5), or guess them.

    They are those of a calibration `file`, whose poses do not count, else guessed focal lengths and the centres of the
    pictures.
    """
    if file is not None:
        found = read_cameras(file, capture.camera_names, 1, capture.sizes)
        return np.asarray(found.intrinsics, float), np.asarray(found.distortion, float)
    matrices = np.tile(np.eye(3), (capture.num_cameras, 1, 1))
    for matrix, video in zip(matrices, footage.videos, strict=True):
        matrix[0, 0] = matrix[1, 1] = video.focal
        matrix[:2, 2] = np.array(video.size) / 2
    return matrices, np.zeros((capture.num_cameras, 5))


def write_static_job(
    capture: Capture,
    matrices: np.ndarray,
    distortion: np.ndarray,
    lengths: Mapping[str, float],
    file: Path,
) -> None:
    """Write `person.npz` of a capture as recorded. Raises `InputError` where two cameras have no keypoints."""
    keypoints = np.zeros((capture.num_cameras, capture.num_frames, 25, 3))
    for camera in range(capture.num_cameras):
        for frame in range(capture.num_frames):
            person = capture.keypoints(camera, frame)
            if person is not None:
                keypoints[camera, frame] = person
    refuse_without_person(capture, keypoints)
    for camera in range(capture.num_cameras):
        matrix = matrices[camera]
        at = keypoints[camera, ..., 2] > 0
        if at.any():
            if distortion[camera].any():
                lens = Undistortion(matrix, distortion[camera], capture.sizes[camera])
                keypoints[camera, at, :2] = lens.points(keypoints[camera, at, :2])
            middle = matrix[1, 2]
            keypoints[camera, at, 1] = middle + (keypoints[camera, at, 1] - middle) * matrix[0, 0] / matrix[1, 1]
    seconds = np.stack(
        [
            index.seconds[numbers] + offset
            for index, numbers, offset in zip(capture.indices, capture.video_frames, capture.offsets, strict=True)
        ]
    )
    np.savez(
        file,
        keypoints=keypoints,
        seconds=seconds,
        counted=np.arange(0, capture.num_frames, -(-capture.num_frames // _MOST_FRAMES)),
        frame=1 / capture.fps,
        video_frames=capture.video_frames,
        intrinsics=matrices,
        distortion=distortion,
        bones=np.array(list(lengths), np.str_),
        lengths=np.array(list(lengths.values()), float),
    )


def refuse_without_person(capture: Capture, keypoints: np.ndarray | None) -> None:
    """Raise `InputError` where cameras that stand still have no keypoints in two of them."""
    detect = f"run jaxmocap detect {capture.folder}, or give keypoint files (keypoints in capture.toml)"
    still = "cameras that stand still are placed by the person's keypoints"
    if keypoints is None or capture.keypoints_folder is None:
        raise InputError(f"{still}, and capture '{capture.name}' has none: {detect}")
    has = np.asarray((keypoints[..., 2] >= CONFIDENT).any(axis=(1, 2)))
    with_them = [name for name, one in zip(capture.camera_names, has, strict=True) if one]
    without = [name for name, one in zip(capture.camera_names, has, strict=True) if not one]
    if without:
        some = f"only '{with_them[0]}' has any" if len(with_them) == 1 else f"{', '.join(without)} has none"
        some = some if with_them else "none has any"
        raise InputError(f"{still} in all of them, and {some}: {detect}")
