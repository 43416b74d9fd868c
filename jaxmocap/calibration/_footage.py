"""What is calibrated: videos, the frames of each, and where the person is, as a job that a child process can read."""

import json
from dataclasses import asdict, dataclass
from pathlib import Path

Box = tuple[float, float, float, float]
"""Left, top, right, bottom in pixels of the recorded video."""


@dataclass(frozen=True)
class VideoFootage:
    """One camera's video: frames `first` to `last`, both included. `focal` is a first guess in pixels, or, if
    `focal_known`, exact. `boxes` and `masks` (files), by frame, cover the person where known."""

    name: str
    path: str
    size: tuple[int, int]
    first: int
    last: int
    focal: float
    focal_known: bool
    boxes: dict[int, Box]
    masks: dict[int, str]

    @property
    def frames(self) -> range:
        return range(self.first, self.last + 1)

    def image_name(self, frame: int) -> str:
        """The image's name in the COLMAP model."""
        return f"{self.name}/{frame:05d}.png"


@dataclass(frozen=True)
class Footage:
    """All videos of a capture. `lags[camera]` is the frame of that video that shows the first one's frame 0.
    `key_step` is the distance between key frames, `seed` that of all random numbers."""

    videos: tuple[VideoFootage, ...]
    lags: tuple[int, ...]
    key_step: int = 5
    num_features: int = 4000
    threads: int = 2
    seed: int = 0

    @property
    def focal_known(self) -> bool:
        """Whether all focal lengths are to be kept as they are."""
        return all(video.focal_known for video in self.videos)

    def key_frames(self, camera: int) -> list[int]:
        """Every `key_step`-th frame of a video, and its last; short videos have at least six where they can."""
        frames = self.videos[camera].frames
        step = max(1, min(self.key_step, len(frames) // 6))
        return sorted({*frames[::step], frames[-1]})

    def instant(self, camera: int, frame: int) -> int:
        """The frame number on the first video's clock."""
        return frame - self.lags[camera]

    def to_json(self) -> str:
        return json.dumps(asdict(self))

    @staticmethod
    def from_file(path: Path) -> "Footage":
        raw = json.loads(path.read_text(encoding="utf-8"))
        videos = []
        for video in raw.pop("videos"):
            boxes = {int(frame): tuple(box) for frame, box in video.pop("boxes").items()}
            masks = {int(frame): file for frame, file in video.pop("masks").items()}
            videos.append(VideoFootage(**(video | {"size": tuple(video["size"])}), boxes=boxes, masks=masks))
        return Footage(**(raw | {"videos": tuple(videos), "lags": tuple(raw["lags"])}))
