"""Videos: an index of presentation timestamps, a reader that finds frames by timestamp, never by counting, and which
frames of several videos show the same instants."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import av
import av.container
import numpy as np
from jaxtyping import Float64, Int64, UInt8

from jaxmocap._results import InputError

_READ_ON = 48  # frames ahead up to which decoding on is preferred to seeking


@dataclass(frozen=True, eq=False)
class VideoIndex:
    """What a video holds.

    Attributes:
        path: its file.
        size: (width, height) as displayed, pixels.
        pts: sorted presentation timestamps, units of the stream's time base.
        seconds: the same since the first frame.
        quarter_turns: counter-clockwise, which bring a stored picture upright.
        mirrored: whether it is flipped left to right before it is turned, as those of front cameras may be.
    """

    path: Path
    size: tuple[int, int]
    pts: Int64[np.ndarray, " frame"]
    seconds: Float64[np.ndarray, " frame"]
    quarter_turns: int
    mirrored: bool = False

    @property
    def num_frames(self) -> int:
        return len(self.pts)

    @property
    def interval(self) -> float:
        """Median time between frames, seconds (0 for a single frame)."""
        return float(np.median(np.diff(self.seconds))) if self.num_frames > 1 else 0.0

    def upright(self, stored: UInt8[np.ndarray, "height width *rgb"]) -> UInt8[np.ndarray, "rows columns *rgb"]:
        """Flip and turn a stored picture as players show it."""
        return np.rot90(stored[:, ::-1] if self.mirrored else stored, self.quarter_turns)


def _open(path: Path, **options: str) -> tuple[av.container.InputContainer, av.VideoStream]:
    if not path.is_file():
        raise InputError(f"video {path} does not exist")
    try:
        container = av.open(str(path), metadata_errors="replace", options=options)
    except (av.FFmpegError, OSError) as error:
        raise InputError(
            f"video {path} cannot be opened: {getattr(error, 'strerror', None) or error}; it is no video, or the file "
            "is damaged or was not copied to its end"
        ) from error
    if not container.streams.video:
        container.close()
        raise InputError(f"{path} has no video stream")
    stream = container.streams.video[0]
    stream.thread_type = "AUTO"
    return container, stream


def index_video(path: Path) -> VideoIndex:
    """Read all timestamps of a video (without decoding it) and decode its first frame for size and rotation."""
    try:
        container, stream = _open(path)
        with container:
            stored, pts = 0, []
            for packet in container.demux(stream):
                stored += packet.size > 0
                if packet.size and not packet.is_discard:
                    pts.append(packet.pts)
            promised = stream.frames if "mp4" in container.format.name else 0
            guessed = container.format.name == "avi" and stream.codec_context.has_b_frames
            time_base = stream.time_base
        if promised > stored:  # an edit list may leave out pictures before a key frame
            stored = _count_stored(path)
        container, stream = _open(path)
        with container:
            first = next(container.decode(stream), None)
    except (av.FFmpegError, OSError) as error:
        raise InputError(
            f"video {path} cannot be decoded: {error}; the file is damaged or its codec unknown"
        ) from error
    if promised > stored:
        raise InputError(
            f"video {path} is cut off: {promised - stored} of its frames are not in the file; copy it again"
        )
    if first is None:
        raise InputError(f"video {path} has no frames")
    if guessed or None in pts or time_base is None or first.pts is None:
        raise InputError(f"video {path} does not tell when each of its frames is shown; convert it to MP4 first")
    values = np.unique(np.asarray(pts, np.int64))
    values = values[values >= first.pts]
    matrix = first.side_data.get("DISPLAYMATRIX")
    a, b, _, c, d = (1, 0, 0, 0, 1) if matrix is None else np.frombuffer(matrix, np.int32)[:5].astype(float)
    mirrored = bool(a * d - b * c < 0)
    turns = (round(first.rotation / 90) + 2 * mirrored) % 4  # the rotation tells where the flipped axis goes
    if abs(first.rotation - 90 * round(first.rotation / 90)) > 1:
        raise InputError(f"video {path} is turned by {first.rotation} degrees; only multiples of 90 are supported")
    size = (first.height, first.width) if turns % 2 else (first.width, first.height)
    seconds = (values - values[0]) * float(time_base)
    return VideoIndex(path, size, values, seconds, turns, mirrored)


def _count_stored(path: Path) -> int:
    """Count the pictures in a file, whether an edit list shows them or not."""
    container, stream = _open(path, ignore_editlist="1")
    with container:
        return sum(packet.size > 0 for packet in container.demux(stream))


def luma_frames(index: VideoIndex) -> Iterator[tuple[int, UInt8[np.ndarray, "height width"]]]:
    """Yield number and brightness of every frame in one pass, as stored: not turned upright, no colours converted.

    Raises `InputError` where the video cannot be decoded.
    """
    container, stream = _open(index.path)
    position = -1
    try:
        with container:
            for frame in container.decode(stream):
                position = int(np.searchsorted(index.pts, -1 if frame.pts is None else frame.pts))
                if position < index.num_frames and index.pts[position] == frame.pts:
                    yield position, frame.to_ndarray(format="gray")
    except (av.FFmpegError, OSError) as error:
        raise InputError(f"video {index.path} cannot be decoded after frame {position}: {error}") from error


class FrameReader:
    """Decodes frames of one video, exactly, in any order; going forward costs no seeking. Holds one frame."""

    def __init__(self, index: VideoIndex):
        self._index = index
        self._container, self._stream = _open(index.path)
        self._frames = self._container.decode(self._stream)
        self._current: av.VideoFrame | None = None
        self._position = -1

    def _advance(self, target: int) -> bool:
        """Decode up to `target`; False if that frame cannot be met going forward."""
        while self._position < target:
            frame = next(self._frames, None)
            if frame is None or frame.pts is None:
                return False
            position = int(np.searchsorted(self._index.pts, frame.pts))
            if position < self._index.num_frames and self._index.pts[position] == frame.pts:
                self._current, self._position = frame, position
        return self._position == target

    def _seek(self, pts: int) -> None:
        self._container.seek(int(pts), stream=self._stream, backward=True)
        self._frames = self._container.decode(self._stream)
        self._current, self._position = None, -1

    def read(self, frame: int) -> UInt8[np.ndarray, "height width 3"]:
        """Read frame number `frame` of the video, upright, RGB. Raises `InputError` if it cannot be decoded."""
        if not 0 <= frame < self._index.num_frames:
            raise IndexError(f"{self._index.path.name} has frames 0..{self._index.num_frames - 1}, not {frame}")
        try:
            found = self._position <= frame <= self._position + _READ_ON and self._advance(frame)
            for start in () if found else (self._index.pts[frame], self._index.pts[0]):
                self._seek(start)
                found = self._advance(frame)
                if found:
                    break
        except (av.FFmpegError, OSError) as error:
            raise InputError(f"video {self._index.path} frame {frame} cannot be decoded: {error}") from error
        if not found or self._current is None:
            raise InputError(
                f"video {self._index.path} frame {frame} cannot be decoded; the file is damaged or was cut off: "
                "copy it again, or shorten the capture"
            )
        return np.ascontiguousarray(self._index.upright(self._current.to_ndarray(format="rgb24")))

    @property
    def corrupt(self) -> bool:
        """Whether the decoder says that the frame last read is damaged."""
        return self._current is not None and bool(self._current.is_corrupt)

    def close(self) -> None:
        self._current = None
        self._container.close()
