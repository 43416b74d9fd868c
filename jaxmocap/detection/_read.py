"""People in the files that OpenPose, Pose2Sim, rtmlib, MMPose, AlphaPose and MediaPipe write, told by their shape."""

import json
import re
from collections.abc import Iterable, Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64

from jaxmocap._results import InputError

from ._layouts import BODY_25, LAYOUTS, Layout, LayoutName, to_body_25

People = list[Float64[np.ndarray, "25 3"]]
Size = tuple[int, int]
_UNREAD = {18: "COCO (18 points)", 15: "MPI (15 points)", 16: "MPII (16 points)"}
_NUMBER = re.compile(r"(\d{1,12})(?:\.\w+)?$")
_OPENPOSE = '{"people": [{"pose_keypoints_2d": [...]}]}'


def read_people(file: Path, layout: LayoutName | None = None, size: Size | None = None) -> People:
    """Read everybody who has a point in the file of one picture, as BODY_25 points: x, y (pixels), confidence.

    `layout` is what `keypoint_layout` in `capture.toml` says; without, the number of points tells it. `size` (width,
    height) of the picture is what MediaPipe's points are shares of. Raises `InputError` for files that cannot be read,
    are of another form or layout, or of a whole video.
    """
    found = _read(file, layout, size)
    if None not in found and found:
        raise InputError(
            f"keypoints {file} are of a whole video, and its name is that of one picture; name it after the camera "
            "alone, such as cam0.json"
        )
    return found.get(None, [])


def read_video(file: Path, layout: LayoutName | None = None, size: Size | None = None) -> dict[int, People]:
    """Read the people of a whole video, by frame from 0, as `read_people` does. The last few files are kept."""
    try:
        found = _kept(file, file.stat().st_mtime_ns, layout, size)
    except OSError as error:
        raise InputError(f"keypoints {file} cannot be read: {error.strerror or error}") from error
    return {frame: [points.copy() for points in people] for frame, people in found.items()}


def people_at(file: Path, frame: int, layout: LayoutName | None, size: Size | None) -> People | None:
    """Read the people of one frame of a whole video's file; None where the file does not speak of the frame."""
    people = _kept(file, file.stat().st_mtime_ns, layout, size).get(frame)
    return None if people is None else [points.copy() for points in people]


def best_person(people: People) -> Float64[np.ndarray, "25 3"] | None:
    """Choose the person of the largest mean confidence; None if there is nobody."""
    return max(people, key=lambda points: float(points[:, 2].mean()), default=None)


@lru_cache(maxsize=16)
def _kept(file: Path, changed: int, layout: LayoutName | None, size: Size | None) -> dict[int, People]:
    """Read a whole video's file once; `changed` (nanoseconds) tells files written anew apart."""
    frames: dict[int, People] = {}
    for frame, people in _read(file, layout, size).items():
        if frame is None and people:
            raise InputError(
                f"keypoints {file} are of one picture, and the name is that of a whole video; name it after camera and "
                "frame, such as cam0_00000_keypoints.json"
            )
        if frame is not None:
            frames[frame] = people
    return frames


def _read(file: Path, layout: LayoutName | None, size: Size | None) -> dict[int | None, People]:
    """People by frame; None is the only picture of the file."""
    document = _json(file)
    layout = _own_layout(file, document) or layout
    result: dict[int | None, People] = {}
    try:
        for frame, numbers in _persons(document, size):
            people = result.setdefault(frame, [])
            if numbers is not None and (points := _points(file, numbers, layout)) is not None:
                people.append(points)
    except InputError:
        raise
    except _SizeMissing:
        raise InputError(
            f"keypoints {file} are MediaPipe's, shares of a picture whose size is not known here; multiply them by it "
            f"and write {_OPENPOSE}"
        ) from None
    except (KeyError, TypeError) as error:
        raise InputError(
            f"keypoints {file} is not an OpenPose file, nor one of MMPose, AlphaPose or MediaPipe: expected {_OPENPOSE}"
        ) from error
    except (ValueError, OverflowError):
        raise InputError(f"keypoints {file} holds something other than numbers") from None
    return result


def _own_layout(file: Path, document: Any) -> LayoutName | None:
    """Read what layout the file itself names, as `write_body_25` does.

    It counts before what `capture.toml` says of all files.
    """
    named = document.get("keypoint_layout") if isinstance(document, dict) else None
    if named is not None and (not isinstance(named, str) or named not in LAYOUTS):
        raise InputError(f"keypoints {file}: keypoint_layout is {named!r}; expected one of {', '.join(LAYOUTS)}")
    return named


def _json(file: Path) -> Any:
    try:
        text = file.read_text(encoding="utf-8")
        if text.strip():
            return json.loads(text)
    except OSError as error:
        raise InputError(f"keypoints {file} cannot be read: {error.strerror or error}") from error
    except (ValueError, RecursionError) as error:
        raise InputError(f"keypoints {file} is not JSON: {error}") from error
    raise InputError(f"keypoints {file} is empty; run the detector again, or remove the file")


class _SizeMissing(Exception):
    """MediaPipe's points without the picture's size."""


_Numbers = list[Any] | np.ndarray
"""One person's x, y, confidence of each point: in a row as the file has them, or (point, 3)."""


def _persons(document: Any, size: Size | None) -> Iterator[tuple[int | None, _Numbers | None]]:
    """Every person of a file with the frame, None for a file of one picture; before them, for every frame, nobody."""
    match document:
        case {"people": people}:
            yield from _of_frame(None, (person["pose_keypoints_2d"] or [] for person in people))
        case {"pose_landmarks": people} | {"landmarks": people}:
            yield from _of_frame(None, (_mediapipe(landmarks, size) for landmarks in _landmark_lists(people)))
        case {"landmark": landmarks}:
            yield from _of_frame(None, [_mediapipe(landmarks, size)])
        case {"instance_info": [{"frame_id": first}, *_] as frames}:  # MMPose's demos count from 1
            start = min(_frame_number(first), 1)
            for one in frames:
                yield from _of_frame(_frame_number(one["frame_id"]) - start, map(_mmpose, one["instances"]))
        case {"instance_info": people}:
            yield from _of_frame(None, map(_mmpose, people))
        case [{"frame_id": _}, *_]:  # MMPose's inferencer, from 0
            for one in document:
                yield from _of_frame(_frame_number(one["frame_id"]), map(_mmpose, one["instances"]))
        case [{"image_id": _}, *_]:
            for one in document:
                yield _frame_number(one["image_id"]), one["keypoints"]
        case [{"keypoint_scores": _}, *_] | []:
            yield from _of_frame(None, map(_mmpose, document))
        case _:
            raise TypeError


def _of_frame(frame: int | None, people: Iterable[_Numbers]) -> Iterator[tuple[int | None, _Numbers | None]]:
    yield frame, None
    for person in people:
        yield frame, person


def _frame_number(name: object) -> int:
    """Of `12`, `"12.jpg"` or `"frame_000012.png"`."""
    found = _NUMBER.search(str(name))
    if found is None:
        raise TypeError
    return int(found[1])


def _mmpose(instance: Any) -> _Numbers:
    places, scores = (np.asarray(instance[name], float) for name in ("keypoints", "keypoint_scores"))
    if scores.ndim != 1 or places.shape != (len(scores), 2):
        raise TypeError
    return np.column_stack([places, scores])


def _landmark_lists(people: Any) -> list[Any]:
    """List the landmarks of everybody: of `null`, of one person with or without a name, or of several."""
    if people is None:
        return []
    if isinstance(people, dict):
        return [people["landmark"]]
    if people and isinstance(people[0], dict):
        return [one["landmark"] for one in people] if "landmark" in people[0] else [people]
    return people


def _mediapipe(landmarks: Any, size: Size | None) -> _Numbers:
    if size is None:
        raise _SizeMissing
    points = np.asarray([(one["x"], one["y"], one["visibility"]) for one in landmarks], float)
    return points.reshape(len(landmarks), 3) * (*size, 1.0)


def _points(file: Path, numbers: Any, named: LayoutName | None) -> np.ndarray | None:
    """One person as BODY_25; None for one without a point. What has neither x nor y was not found."""
    in_a_row = isinstance(numbers, list)
    count = len(numbers) / 3 if in_a_row else len(numbers)
    layout = _layout(file, f"{len(numbers)} {'numbers' if in_a_row else 'points'}", count, named)
    try:
        points = np.asarray(numbers, float).reshape(int(count), 3)[: len(layout.points)]
    except TypeError as error:
        raise ValueError from error
    points[np.isnan(points[:, :2]).all(1)] = 0.0
    points[:, 2] = np.minimum(points[:, 2], 1.0)  # heights of a heat map, sums of two: some programs go up to 10
    if not np.isfinite(points).all():
        raise InputError(f"keypoints {file} holds values that are not finite")
    return to_body_25(points, layout) if (points[:, 2] > 0).any() else None


def _layout(file: Path, found: str, count: float, named: LayoutName | None) -> Layout:
    """Choose the layout of a person of `count` points.

    What `keypoint_layout` names counts where the number says nothing: the points come first, and others of the
    program's own may follow.
    """
    told = next((layout for layout in LAYOUTS.values() if len(layout.points) == count), None)
    if named is None:
        if told is not None:
            return told
        looks = f", which looks like {_UNREAD[int(count)]}" if count in _UNREAD else ""
        others = ", ".join(f"{3 * len(one.points)} of {one.title}" for one in LAYOUTS.values() if one is not BODY_25)
        raise InputError(
            f"keypoints {file}: a person has {found}{looks}; expected the 75 of OpenPose BODY_25 (25 points, x y "
            f"confidence), or {others}; keypoint_layout in capture.toml names the layout of any other number"
        )
    layout = LAYOUTS[named]
    if told is layout or (told is None and count > len(layout.points) and count == int(count)):
        return layout
    looks = f", which looks like {told.title}" if told is not None else ""
    raise InputError(
        f"keypoints {file}: a person has {found}{looks}; keypoint_layout = {named!r} in capture.toml expects the "
        f"{3 * len(layout.points)} of {layout.title} (x y confidence); correct or remove the line"
    )
