"""Where the keypoints of a video lie: one file per picture, or one for the whole video, by the names programs give;
and a file of one picture, written."""

import json
import re
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64

from jaxmocap._files import is_clutter, write_text

from ._layouts import LayoutName
from ._read import People, Size, people_at, read_people, read_video

_AT_THE_TOP = re.compile(r".+_(\d{5,})_keypoints\.json")
_BEYOND = 0.1  # of the picture's size
_SHARE_BEYOND = 0.1  # of the points
_INSIDE = re.compile(r"(?:.*_)?(\d{4,})(?:_keypoints)?\.json")


@dataclass(frozen=True)
class VideoKeypoints:
    """A detector's keypoints of one video. Frames are numbered from 0 in the video.

    Attributes:
        folder: where the files of all cameras lie.
        names: by which the files are named; the camera's first, then that of the video without its suffix.
        layout: of the points; None: told by their number.
        size: (width, height) of the video in pixels.
    """

    folder: Path
    names: tuple[str, ...]
    layout: LayoutName | None
    size: Size

    def expected_file(self, frame: int) -> Path:
        """Return our own name of the file of one frame."""
        return self.folder / f"{self.names[0]}_{frame:05d}_keypoints.json"

    def frame_file(self, frame: int) -> Path | None:
        """Find the file of one frame.

        It is `<camera>_00012_keypoints.json`, OpenPose's `<video>_000000000012_keypoints.json`, or any name that ends
        in the frame's number (4 digits or more) in a folder `<video>_json`, as Pose2Sim writes it, or `<video>`.
        """
        for file in (
            self.expected_file(frame),
            *(self.folder / f"{name}_{frame:012d}_keypoints.json" for name in self.names),
        ):
            if file.is_file():
                return file
        return next((files[frame] for files in map(_numbered, self._folders()) if frame in files), None)

    def frame_files(self) -> dict[int, Path]:
        """List the file of every frame that has one of its own."""
        frames = {int(found[1]) for file in self.folder.iterdir() if (found := _AT_THE_TOP.fullmatch(file.name))}
        frames = frames.union(*map(_numbered, self._folders()))
        return {frame: file for frame in sorted(frames) if (file := self.frame_file(frame)) is not None}

    def video_file(self) -> Path | None:
        """Find the file of the whole video.

        It is `<camera>.json` or `<video>.json`, `results_<video>.json` as MMPose's demos call it,
        `predictions/<video>.json` as its inferencer does, or AlphaPose's `alphapose-results.json` in a folder
        `<video>`.
        """
        forms = ("{}.json", "results_{}.json", "predictions/{}.json", "{}/alphapose-results.json")
        files = (self.folder / form.format(name) for form in forms for name in self.names)
        return next((file for file in files if file.is_file()), None)

    def has(self, frame: int) -> bool:
        """Tell whether the detector says anything about a frame, be it that nobody is there.

        Raises `InputError` for a whole video's file that cannot be read.
        """
        return self.frame_file(frame) is not None or self._of_video(frame) is not None

    def people(self, frame: int) -> People:
        """Read everybody at one frame, as `read_people`; nobody where there is no file.

        Raises `InputError` for a file that cannot be read.
        """
        file = self.frame_file(frame)
        return (self._of_video(frame) or []) if file is None else read_people(file, self.layout, self.size)

    def read_all(self) -> dict[int, People]:
        """Read everybody of every frame that there is a file for.

        Raises `InputError` for a file that cannot be read.
        """
        file = self.video_file()
        found = {} if file is None else read_video(file, self.layout, self.size)
        return found | {frame: read_people(path, self.layout, self.size) for frame, path in self.frame_files().items()}

    def _of_video(self, frame: int) -> People | None:
        file = self.video_file()
        return None if file is None else people_at(file, frame, self.layout, self.size)

    def _folders(self) -> list[Path]:
        folders = (self.folder / name for base in self.names for name in (f"{base}_json", base))
        return [folder for folder in folders if folder.is_dir()]


def _numbered(folder: Path) -> dict[int, Path]:
    """List the files of a folder by the frame their names end in."""
    return _kept_listing(folder, folder.stat().st_mtime_ns)


@lru_cache(maxsize=64)
def _kept_listing(folder: Path, changed: int) -> dict[int, Path]:
    """List a folder once; `changed` (nanoseconds) tells that files came or went."""
    found: dict[int, Path] = {}
    for file in sorted(folder.iterdir()):
        if (name := _INSIDE.fullmatch(file.name)) and file.is_file() and not is_clutter(file.name):
            found.setdefault(int(name[1]), file)
    return found


def farthest_outside(people: People, size: Size) -> tuple[float, float] | None:
    """Find how far points go, x and y in pixels, where many lie outside a picture of `size` (width, height).

    None where few do, as those of people who walk out of it: the detector saw pictures of this size or of a smaller.
    """
    points = np.concatenate([np.zeros((0, 3)), *people])
    places = points[points[:, 2] > 0, :2]
    beyond = ((places < -_BEYOND * np.array(size)) | (places > (1 + _BEYOND) * np.array(size))).any(1)
    if not len(places) or beyond.mean() <= _SHARE_BEYOND:
        return None
    x, y = places.max(0)
    return float(x), float(y)


def write_body_25(file: Path, points: Float64[np.ndarray, "25 3"], **about: Any) -> None:
    """Write the BODY_25 points (x, y in the video's pixels, confidence) of one person, atomically.

    The file is in OpenPose's form and says how its points are laid out. Nobody is there where no point has a
    confidence. `about` are further entries, which readers pass over.
    """
    rows = [[round(float(x), 2), round(float(y), 2), round(float(c), 4)] if c > 0 else [0, 0, 0] for x, y, c in points]
    people = [{"pose_keypoints_2d": [number for row in rows for number in row]}] if any(row[2] for row in rows) else []
    write_text(file, json.dumps({"version": 1.3, "keypoint_layout": "body25", **about, "people": people}) + "\n")
