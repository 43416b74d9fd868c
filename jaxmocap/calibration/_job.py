"""From a capture to the job of the worker: frames, first guesses of focal lengths, and where the person is."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from jaxmocap._results import InputError
from jaxmocap.capture import Capture, best_person, keypoint_file, mask_file, read_people

from ._focal import guess_focal
from ._footage import Box, Footage, VideoFootage

_MARGIN = 1.0  # seconds before and after the shared frames, so that `offset` may still be corrected
_CONFIDENT = 0.3


def as_recorded(capture: Capture) -> Capture:
    """The capture without its cameras: images, masks and keypoints lie in the recorded videos."""
    return replace(capture.as_recorded(), cameras_path=None)


def footage_of(capture: Capture, focal: Mapping[str, float] | None, key_step: int, threads: int, seed: int) -> Footage:
    """The job. `focal` gives focal lengths by camera, in pixels, that are then kept. Raises `InputError` for fewer than
    two cameras or frames, and for focal lengths of cameras that do not exist."""
    focal = dict(focal or {})
    unknown = sorted(set(focal) - set(capture.camera_names))
    if unknown:
        raise InputError(
            f"a focal length is given for {', '.join(unknown)}, but the cameras are {', '.join(capture.camera_names)}"
        )
    if focal and set(focal) != set(capture.camera_names):
        raise InputError("give the focal length of every camera, or of none")
    if wrong := [f"{name} {value:g}" for name, value in focal.items() if not 10 < value < 1e5]:
        raise InputError(f"focal lengths are in pixels, about the width of the image; found {', '.join(wrong)}")
    if capture.num_cameras < 2:
        raise InputError(
            f"capture '{capture.name}' has one camera; two or more are needed to place them and the person in space"
        )
    if capture.num_frames < 2:
        raise InputError(f"capture '{capture.name}' has {capture.num_frames} shared frame; several are needed")
    if key_step < 1:
        raise InputError(f"--key-step is {key_step}; one key frame every so many frames, 1 or more, was expected")
    margin = round(_MARGIN * capture.fps)
    videos = []
    for camera, (name, index) in enumerate(zip(capture.camera_names, capture.indices, strict=True)):
        own = capture.video_frames[camera]
        first, last = max(int(own[0]) - margin, 0), min(int(own[-1]) + margin, index.num_frames - 1)
        guess = focal.get(name) or guess_focal(index.path, index.size)
        videos.append(
            VideoFootage(
                name=name,
                path=str(index.path.resolve()),
                size=index.size,
                first=first,
                last=last,
                focal=guess,
                focal_known=name in focal,
                boxes=_boxes(capture, name, range(first, last + 1)),
                masks=_masks(capture, name, range(first, last + 1)),
            )
        )
    lags = tuple(int(row[0] - capture.video_frames[0, 0]) for row in capture.video_frames)
    return Footage(tuple(videos), lags, key_step=key_step, threads=threads, seed=seed)


def _boxes(capture: Capture, camera: str, frames: range) -> dict[int, Box]:
    """Around the keypoints of each frame that has them."""
    boxes: dict[int, Box] = {}
    if capture.keypoints_folder is None:
        return boxes
    for frame in frames:
        file = keypoint_file(capture.keypoints_folder, camera, frame)
        person = best_person(read_people(file)) if file.is_file() else None
        if person is not None and (person[:, 2] >= _CONFIDENT).sum() >= 4:
            places = person[person[:, 2] >= _CONFIDENT, :2]
            boxes[frame] = (*places.min(0).tolist(), *places.max(0).tolist())
    return boxes


def _masks(capture: Capture, camera: str, frames: range) -> dict[int, str]:
    if capture.masks_folder is None:
        return {}
    files = {frame: mask_file(capture.masks_folder, camera, frame) for frame in frames}
    return {frame: str(file.resolve()) for frame, file in files.items() if file.is_file()}


def keypoints_of(capture: Capture, most: int = 30) -> dict[int, np.ndarray]:
    """BODY_25 keypoints (camera, 25, 3), in the recorded videos, of at most so many shared frames at which two cameras
    have them. `capture` is as recorded."""
    frames = [set(capture.keypoint_frames(camera)) for camera in range(capture.num_cameras)]
    shared = sorted(f for f in set().union(*frames) if sum(f in own for own in frames) >= 2)
    found = {}
    for frame in shared[:: max(1, -(-len(shared) // most))]:
        people = [capture.keypoints(camera, frame) for camera in range(capture.num_cameras)]
        found[frame] = np.stack([np.zeros((25, 3)) if person is None else person for person in people])
    return found
