"""Checks of keypoint and mask files: names and content."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Literal

import numpy as np

from jaxmocap._files import is_clutter
from jaxmocap._results import InputError
from jaxmocap.camera import ranges
from jaxmocap.detection import VideoKeypoints, best_person, farthest_outside, read_people, read_video

from ._capture import Capture
from ._config import Finding
from ._picture_steps import mask_file, read_mask


def _stray(capture: Capture, file: Path, suffix: str, more: str = "") -> Finding:
    expected = f"{capture.camera_names[0]}_00000{suffix}"
    names = ", ".join(capture.camera_names)
    return Finding(
        "warning",
        f"{file.parent.name}/{file.name}",
        f"{file} is ignored: its name should be like {expected}, with one of {names}{more}",
    )


def _missing(capture: Capture, kind: str, index: int, own: int, file: Path) -> Finding:
    camera = capture.camera_names[index]
    return Finding(
        "warning",
        f"{camera} frame {own}",
        f"{kind} are missing at the selected frame {own} of {camera}: no {file}",
    )


def check_keypoints(capture: Capture) -> Iterator[Finding]:
    """Check layout, number of people, points outside the picture, and files.

    A file may be missing at a selected frame, or never be read.
    """
    folder = capture.keypoints_folder
    if folder is None:
        yield Finding(
            "note", "keypoints", "there are no keypoints; the pose at the first frame has to come from elsewhere"
        )
        return
    if not folder.is_dir():
        return
    used: set[Path] = set()
    for index in range(capture.num_cameras):
        source = capture.video_keypoints(index)
        assert source is not None
        files, video = source.frame_files(), source.video_file()
        read = [*files.values(), *([] if video is None else [video])]
        used |= {*read, *(file.parent for file in read)}
        yield from _check_files(capture, index, source, files, video)
    more = ", or one that a detector gives, and one file for a frame"
    for path in sorted(folder.iterdir()):
        if path in used or is_clutter(path.name):
            continue
        if path.suffix == ".json" or (path.is_dir() and any(path.glob("*.json"))):
            yield _stray(capture, path, "_keypoints.json", more)


def _check_files(
    capture: Capture, index: int, source: VideoKeypoints, files: dict[int, Path], video: Path | None
) -> Iterator[Finding]:
    """Check what the files of one camera hold."""
    name, chosen, readable = capture.camera_names[index], [], True
    refused, nobody, several, beyond = (dict[int, str]() for _ in range(4))
    for frame, file in files.items():
        try:
            people = read_people(file, source.layout, source.size)
        except InputError as error:
            refused[frame] = str(error)
            continue
        person = best_person(people)
        if person is None:
            nobody[frame] = f"keypoints {file} show nobody"
        else:
            chosen.append(person)
        if person is not None and len(people) > 1:
            several[frame] = (
                f"keypoints {file} show {len(people)} people; the one of the largest confidence "
                f"({person[:, 2].mean():.2f}) is taken: remove the others if that is not the actor"
            )
        if frame >= capture.indices[index].num_frames:
            beyond[frame] = f"{file} is beyond the end of {capture.videos[index].name}"
    yield from _once("error", name, refused)
    for found in (nobody, several, beyond):
        yield from _once("warning", name, found)
    if video is not None:
        try:
            frames = read_video(video, source.layout, source.size)
        except InputError as error:
            readable = False
            yield Finding("error", name, str(error))
        else:
            chosen += [person for people in frames.values() if (person := best_person(people)) is not None]
            yield from _check_video(capture, index, video, frames)
    yield from _outside(capture, index, source, chosen)
    for frame in capture.selected_frames or ():
        own = int(capture.video_frames[index, frame])
        if source.frame_file(own) is None and not (readable and source.has(own)):
            yield _missing(capture, "keypoints", index, own, source.expected_file(own))


def _once(severity: Literal["error", "warning"], name: str, found: dict[int, str]) -> Iterator[Finding]:
    """Say what was found in many files of a camera once, of the first of them."""
    if found:
        first, *others = found
        more = f"; the same of {len(others)} more, at frame {ranges(others)}" if others else ""
        yield Finding(severity, f"{name} frame {first}", found[first] + more)


def _check_video(capture: Capture, index: int, file: Path, frames: dict[int, list[np.ndarray]]) -> Iterator[Finding]:
    """Check a file of the whole video, each finding once."""
    name, count = capture.camera_names[index], capture.indices[index].num_frames
    several = [frame for frame, people in frames.items() if len(people) > 1]
    if not any(frames.values()):
        yield Finding("warning", name, f"keypoints {file} show nobody")
    if several:
        yield Finding(
            "warning",
            name,
            f"keypoints {file} show several people at {len(several)} frames, first at {min(several)}; the one of the "
            "largest confidence is taken: remove the others if that is not the actor",
        )
    if frames and max(frames) >= count:
        yield Finding(
            "warning", name, f"{file} goes on to frame {max(frames)}, beyond the end of {capture.videos[index].name}"
        )


def _outside(capture: Capture, index: int, source: VideoKeypoints, people: list[np.ndarray]) -> Iterator[Finding]:
    """Points of pictures of another size than the video's."""
    if (farthest := farthest_outside(people, source.size)) is not None:
        x, y = farthest
        name, width, height = capture.camera_names[index], *source.size
        yield Finding(
            "warning",
            name,
            f"keypoints of {name} lie as far as {x:.4g}, {y:.4g}, outside the {width}x{height} pixels of "
            f"{capture.videos[index].name}: the detector saw pictures of another size; run it on this video",
        )


def check_masks(capture: Capture) -> Iterator[Finding]:
    """Check masks for size, empty and full ones, and files missing at the selected frames or never read."""
    folder = capture.masks_folder
    if folder is None or not folder.is_dir():
        return
    for file in sorted(folder.glob("*.png")):
        if is_clutter(file.name):
            continue
        match = re.fullmatch(r"(.+)_(\d{5,})\.png", file.name)
        if match is None or match[1] not in capture.camera_names or len(match[2]) > max(5, len(str(int(match[2])))):
            yield _stray(capture, file, ".png")
            continue
        camera_index, frame = capture.camera_names.index(match[1]), int(match[2])
        where = f"{capture.camera_names[camera_index]} frame {frame}"
        try:
            mask = read_mask(file, capture.sizes[camera_index])
        except InputError as error:
            yield Finding("error", where, str(error))
            continue
        if not mask.any():
            yield Finding("error", where, f"mask {file} is empty; expected the person in white on black")
        elif mask.mean() > 0.9:
            yield Finding("warning", where, f"mask {file} covers {mask.mean():.0%} of the image; is it inverted?")
    for frame in capture.selected_frames or ():
        for index, camera in enumerate(capture.camera_names):
            own = int(capture.video_frames[index, frame])
            file = mask_file(folder, camera, own)
            if not file.is_file():
                yield _missing(capture, "masks", index, own, file)
