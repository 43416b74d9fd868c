"""Checks of keypoint and mask files: names and content."""

import re
from collections.abc import Callable, Iterator
from pathlib import Path

from jaxmocap._results import InputError

from ._capture import Capture
from ._config import Finding
from ._keypoints import best_person, keypoint_file, mask_file, read_mask, read_people


def _files(capture: Capture, folder: Path, suffix: str) -> Iterator[tuple[Path, int | None, int]]:
    """Every file of a folder that ends in `suffix`: (file, camera index or None, frame number in its own video)."""
    pattern = re.compile(r"(.+)_(\d{5,})" + re.escape(suffix))
    for file in sorted(folder.glob(f"*{suffix}")):
        match = pattern.fullmatch(file.name)
        if match is None or match[1] not in capture.camera_names or len(match[2]) > max(5, len(str(int(match[2])))):
            yield file, None, -1
        else:
            yield file, capture.camera_names.index(match[1]), int(match[2])


def _stray(capture: Capture, file: Path, suffix: str) -> Finding:
    expected = f"{capture.camera_names[0]}_00000{suffix}"
    names = ", ".join(capture.camera_names)
    return Finding(
        "warning",
        f"{file.parent.name}/{file.name}",
        f"{file} is ignored: its name should be like {expected}, with one of {names}",
    )


def _missing(capture: Capture, kind: str, path_of: Callable[[str, int], Path]) -> Iterator[Finding]:
    for frame in capture.selected_frames or ():
        for index, camera in enumerate(capture.camera_names):
            own = int(capture.video_frames[index, frame])
            if not path_of(camera, own).is_file():
                where = f"{camera} frame {own}"
                yield Finding(
                    "warning",
                    where,
                    f"{kind} are missing at the selected frame {own} of {camera}: no {path_of(camera, own)}",
                )


def check_keypoints(capture: Capture) -> Iterator[Finding]:
    """Layout, number of people, files that are missing at the selected frames or never read."""
    folder, suffix = capture.keypoints_folder, "_keypoints.json"
    if folder is None:
        yield Finding(
            "note", "keypoints", "there are no keypoints; the pose at the first frame has to come from elsewhere"
        )
        return
    if not folder.is_dir():
        return
    for file, camera_index, frame in _files(capture, folder, suffix):
        if camera_index is None:
            yield _stray(capture, file, suffix)
            continue
        where = f"{capture.camera_names[camera_index]} frame {frame}"
        try:
            people = read_people(file)
        except InputError as error:
            yield Finding("error", where, str(error))
            continue
        if not people:
            yield Finding("warning", where, f"keypoints {file} show nobody")
        elif len(people) > 1:
            chosen = best_person(people)
            confidence = 0.0 if chosen is None else chosen[:, 2].mean()
            yield Finding(
                "warning",
                where,
                f"keypoints {file} show {len(people)} people; the one of the largest confidence ({confidence:.2f}) "
                "is taken: remove the others if that is not the actor",
            )
        if frame >= capture.indices[camera_index].num_frames:
            yield Finding("warning", where, f"{file} is beyond the end of {capture.videos[camera_index].name}")
    yield from _missing(capture, "keypoints", lambda camera, frame: keypoint_file(folder, camera, frame))


def check_masks(capture: Capture) -> Iterator[Finding]:
    """Size, empty and full masks, files that are missing at the selected frames or never read."""
    folder = capture.masks_folder
    if folder is None or not folder.is_dir():
        return
    for file, camera_index, frame in _files(capture, folder, ".png"):
        if camera_index is None:
            yield _stray(capture, file, ".png")
            continue
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
    yield from _missing(capture, "masks", lambda camera, frame: mask_file(folder, camera, frame))
