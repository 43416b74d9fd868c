"""What is calibrated: the videos, the frames of each, and where the person is in them.

A capture becomes `Footage`, which the child process reads as JSON.
"""

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from jaxmocap._results import InputError
from jaxmocap.capture import LONGEST_SIDE, Capture, mask_file, reduced_size
from jaxmocap.detection import best_person

from ._focal import told_focal, usual_focal

Box = tuple[float, float, float, float]
"""Left, top, right, bottom in pixels of the recorded video."""

Report = Callable[[str, int, int], None]
"""Takes progress: the stage, how many of its steps are done, and how many there are."""

CONFIDENT = 0.3  # keypoints of less do not count
_MARGIN = 1.0  # seconds before and after the shared frames, so that `offset` may still be corrected


@dataclass(frozen=True)
class VideoFootage:
    """One camera's video.

    Attributes:
        name: of the camera.
        path: of the video file.
        size: width and height of the pictures that are looked at, pixels.
        first: the first frame that is calibrated.
        last: the last one, included.
        seconds: at which each of these was taken, on the clock that all videos share.
        focal: length, pixels; a first guess unless `focal_known`.
        focal_known: whether `focal` is exact, and kept.
        focal_told: whether it is from the video's metadata.
        boxes: around the person, by frame, where keypoints tell.
        masks: files with masks of the person, by frame, where there are any.
        recorded_size: of the pictures as they were recorded, where they are made smaller.
        wanted: those of its frames, in the order of the shared ones, at which it has to be placed; empty: all.
    """

    name: str
    path: str
    size: tuple[int, int]
    first: int
    last: int
    seconds: tuple[float, ...]
    focal: float
    focal_known: bool
    focal_told: bool
    boxes: dict[int, Box]
    masks: dict[int, str]
    recorded_size: tuple[int, int] | None = None
    wanted: tuple[int, ...] = ()

    def reduced(self) -> "VideoFootage":
        """Make the pictures that are looked at no larger than `LONGEST_SIDE`."""
        size = reduced_size(self.size, LONGEST_SIDE)
        if size == self.size:
            return self
        x, y = size[0] / self.size[0], size[1] / self.size[1]
        boxes = {
            frame: (x * left, y * top, x * right, y * low) for frame, (left, top, right, low) in self.boxes.items()
        }
        return replace(self, size=size, recorded_size=self.size, focal=x * self.focal, boxes=boxes)

    @property
    def frames(self) -> range:
        return range(self.first, self.last + 1)

    def image_name(self, frame: int) -> str:
        """Name the image of a frame in the COLMAP model."""
        return f"{self.name}/{frame:05d}.png"

    def listed_name(self, frame: int) -> str:
        """Name it in lists, in which blanks part one name from the next; cameras' names have no plus."""
        return self.image_name(frame).replace(" ", "+")


@dataclass(frozen=True)
class Footage:
    """All videos of a capture.

    Attributes:
        videos: one per camera.
        key_step: frames from one key frame to the next; 5 by default.
        num_features: looked for in a frame, at most; 4000 by default.
        seed: of all random numbers; 0 by default.
        first_wanted: the first shared frame at which cameras have to be placed; 0 by default.
    """

    videos: tuple[VideoFootage, ...]
    key_step: int = 5
    num_features: int = 4000
    seed: int = 0
    first_wanted: int = 0

    @property
    def focal_known(self) -> bool:
        """Whether all focal lengths are to be kept as they are."""
        return all(video.focal_known for video in self.videos)

    def reduced(self) -> "Footage":
        """Make the pictures of all videos smaller where they are large.

        Of plaza and street, made 640 pixels wide, cameras came out as good as of 960 in half the time; and COLMAP has
        thresholds in pixels, which features of a 4K picture's noise and compression do not keep to.
        """
        return replace(self, videos=tuple(video.reduced() for video in self.videos))

    def key_frames(self, camera: int) -> list[int]:
        """Choose every `key_step`-th frame of a video, and its last; short videos have at least six where they can."""
        frames = self.videos[camera].frames
        step = max(1, min(self.key_step, len(frames) // 6))
        return sorted({*frames[::step], frames[-1]})

    def wanted_key_frames(self, camera: int) -> list[int]:
        """Choose those among the key frames at which the camera has to be placed; all where none is."""
        keys, wanted = self.key_frames(camera), self.videos[camera].wanted
        return [frame for frame in keys if wanted and wanted[0] <= frame <= wanted[-1]] or keys

    def instant(self, camera: int, frame: int) -> float:
        """Tell when a frame was taken, seconds on the clock that all videos share."""
        video = self.videos[camera]
        return video.seconds[frame - video.first]

    def to_json(self) -> str:
        """Write the job as text for `from_file`."""
        return json.dumps(asdict(self))

    @staticmethod
    def from_file(path: Path) -> "Footage":
        """Read what `to_json` wrote."""
        raw = json.loads(path.read_text(encoding="utf-8"))
        videos = []
        for video in raw.pop("videos"):
            boxes = {int(frame): tuple(box) for frame, box in video.pop("boxes").items()}
            masks = {int(frame): file for frame, file in video.pop("masks").items()}
            lists = {name: tuple(video[name]) for name in ("size", "seconds", "wanted")}
            videos.append(VideoFootage(**(video | lists), boxes=boxes, masks=masks))
        return Footage(**(raw | {"videos": tuple(videos)}))


def as_recorded(capture: Capture) -> Capture:
    """Return the capture without its cameras: images, masks and keypoints lie in the recorded videos."""
    return replace(capture.as_recorded(), cameras_path=None)


def footage_of(
    capture: Capture,
    focal: Mapping[str, float] | None,
    wanted: tuple[int, int],
    key_step: int,
    seed: int,
) -> Footage:
    """Gather what the child process needs of a capture as it was recorded.

    `focal` gives focal lengths by camera, in pixels, that are then kept; `wanted` (first, end) are the shared frames at
    which all cameras have to be placed. Raises `InputError` for fewer than two cameras
    or frames, and for focal lengths of cameras that do not exist.
    """
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
        told = told_focal(index.path, index.size)
        videos.append(
            VideoFootage(
                name=name,
                path=str(index.path.resolve()),
                size=index.size,
                first=first,
                last=last,
                seconds=tuple(np.round(index.seconds[first : last + 1] + capture.offsets[camera], 4).tolist()),
                focal=focal.get(name) or usual_focal(index.path, index.size),
                focal_known=name in focal,
                focal_told=told is not None,
                boxes=_boxes(capture, name, range(first, last + 1)),
                masks=_masks(capture, name, range(first, last + 1)),
                wanted=tuple(own[slice(*wanted)].tolist()),
            )
        )
    return Footage(tuple(videos), key_step=key_step, seed=seed, first_wanted=wanted[0])


def _boxes(capture: Capture, camera: str, frames: range) -> dict[int, Box]:
    """Put a box around the keypoints of each frame that has them."""
    boxes: dict[int, Box] = {}
    source = capture.video_keypoints(capture.camera_names.index(camera))
    if source is None:
        return boxes
    for frame in frames:
        person = best_person(source.people(frame))
        if person is not None and (person[:, 2] >= CONFIDENT).sum() >= 4:
            places = person[person[:, 2] >= CONFIDENT, :2]
            boxes[frame] = (*places.min(0).tolist(), *places.max(0).tolist())
    return boxes


def _masks(capture: Capture, camera: str, frames: range) -> dict[int, str]:
    if capture.masks_folder is None:
        return {}
    files = {frame: mask_file(capture.masks_folder, camera, frame) for frame in frames}
    return {frame: str(file.resolve()) for frame, file in files.items() if file.is_file()}
