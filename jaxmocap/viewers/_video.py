"""A result over the videos it was tracked in: H.264, written frame by frame at the frames' own times."""

import contextlib
import os
from collections.abc import Iterable, Iterator
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
from av.container import OutputContainer
from jaxtyping import UInt8

from jaxmocap._files import atomic_path
from jaxmocap._results import InputError
from jaxmocap.camera import Cameras
from jaxmocap.capture import Capture
from jaxmocap.character import Character
from jaxmocap.motion import Motion

from ._overlay import OverlayStyle, draw_overlay

_TIME_BASE = Fraction(1, 90000)
_NOMINAL_RATE = Fraction(30)  # only a hint for the encoder and in the header; the frames carry their times


def overlay_video(
    capture: Capture,
    cameras: Cameras,
    character: Character,
    motion: Motion,
    camera_index: int,
    path: str | os.PathLike[str],
    *,
    style: OverlayStyle = OverlayStyle(),
) -> Path:
    """Write the frames of a motion, drawn over one camera's images, as H.264; streaming, atomic, at the frames' times.

    `cameras` cover the whole capture. Raises `InputError` for frames that the capture does not have.
    """
    return write_overlay_video(path, overlay_frames(capture, cameras, character, motion, camera_index, style=style))


def overlay_videos(
    capture: Capture, cameras: Cameras, motion: Motion, folder: str | os.PathLike[str]
) -> tuple[Path, ...]:
    """Write one overlay video per view, `overlay_<camera>.mp4` in `folder`."""
    return tuple(
        overlay_video(capture, cameras, motion.character, motion, index, Path(folder) / f"overlay_{name}.mp4")
        for index, name in enumerate(cameras.names)
    )


def overlay_frames(
    capture: Capture,
    cameras: Cameras,
    character: Character,
    motion: Motion,
    camera_index: int,
    *,
    style: OverlayStyle = OverlayStyle(),
) -> Iterator[tuple[float, UInt8[np.ndarray, "height width 3"]]]:
    """Yield `(seconds, RGB image with the tracked body)` for every frame of a motion in one view.

    `cameras` cover the whole capture, or are the motion's own.
    """
    positions, view = positions_in_capture(capture, motion), view_in_capture(capture, cameras.names[camera_index])
    poses = np.asarray(cameras.cam_from_world)[camera_index]
    if cameras is not motion.cameras:
        poses = poses[positions]
    sizes = tuple(capture.sizes[view] if index == camera_index else size for index, size in enumerate(cameras.sizes))
    intrinsics, faces = np.asarray(cameras.resized(sizes).intrinsics)[camera_index], np.asarray(character.faces)
    for index, position in enumerate(positions):
        image = draw_overlay(
            capture.image(view, position),
            motion.vertices(index),
            faces,
            intrinsics,
            poses[index],
            joints=motion.joints[index],
            joint_names=motion.joint_names,
            confidence=motion.confidence[index],
            status=str(motion.status[index]),
            label=f"{cameras.names[camera_index]}  frame {motion.frames[index]}  {motion.timestamps[index]:.2f} s",
            style=style,
        )
        yield float(motion.timestamps[index]), image


def positions_in_capture(capture: Capture, motion: Motion) -> list[int]:
    """Find where the motion's frames are in the capture.

    A result counts as its first camera's video does, a capture counts the frames all cameras share. Raises `InputError`
    for a frame the capture does not have, or if it lacks that camera.
    """
    view = 0 if motion.cameras is None else view_in_capture(capture, motion.cameras.names[0])
    positions = {int(frame): position for position, frame in enumerate(capture.video_frames[view])}
    missing = [frame for frame in motion.frames.tolist() if frame not in positions]
    if missing:
        raise InputError(
            f"Frame {missing[0]} of the result is not among the frames that all cameras of {capture.folder} share "
            f"({capture.video_frames[view, 0]} to {capture.video_frames[view, -1]}); is it of another capture?"
        )
    return [positions[frame] for frame in motion.frames.tolist()]


def view_in_capture(capture: Capture, name: str) -> int:
    """Find a result's camera among those of a capture. Raises `InputError` where it is not."""
    if name not in capture.camera_names:
        raise InputError(
            f"Camera {name} of the result is not among those of {capture.folder} ({', '.join(capture.camera_names)}); "
            "is it of another capture?"
        )
    return capture.camera_names.index(name)


class VideoWriter:
    """H.264 in an MP4 file at the timestamps given, in seconds; yuv420p, so odd sizes repeat their last row or column.

    Use through `open_video`. Raises `InputError` if times do not increase or the size changes.
    """

    def __init__(self, container: OutputContainer, path: Path, quality: int):
        self._container, self._path, self._quality = container, path, quality
        self._stream = None
        self._shape: tuple[int, ...] = ()
        self._last = -1
        self._start = 0.0

    def write(self, seconds: float, image: UInt8[np.ndarray, "height width 3"]) -> None:
        """Append an RGB image. The first image's time becomes the start of the video."""
        if self._stream is None:
            self._shape, self._start = image.shape, seconds
            self._stream = self._container.add_stream("libx264", rate=_NOMINAL_RATE, options=self._options())
            self._stream.width, self._stream.height = (
                image.shape[1] + image.shape[1] % 2,
                image.shape[0] + image.shape[0] % 2,
            )
            self._stream.pix_fmt = "yuv420p"
            self._stream.time_base = self._stream.codec_context.time_base = _TIME_BASE
        if image.shape != self._shape:
            raise InputError(f"{self._path}: an image of shape {image.shape} follows images of shape {self._shape}.")
        ticks = round((seconds - self._start) / _TIME_BASE)
        if ticks <= self._last:
            raise InputError(f"{self._path}: the frame at {seconds:g} s does not come after the one before it.")
        self._last = ticks
        padding = ((0, self._stream.height - image.shape[0]), (0, self._stream.width - image.shape[1]), (0, 0))
        frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(np.pad(image, padding, mode="edge")), format="rgb24")
        frame.pts, frame.time_base = ticks, _TIME_BASE
        self._container.mux(self._stream.encode(frame))

    def finish(self) -> None:
        """Flush the encoder."""
        if self._stream is None:
            raise InputError(f"{self._path}: a video needs at least one frame; none were given.")
        self._container.mux(self._stream.encode())

    def _options(self) -> dict[str, str]:
        return {"crf": str(self._quality), "preset": "veryfast"}


@contextlib.contextmanager
def open_video(path: str | os.PathLike[str], *, quality: int = 23) -> Iterator[VideoWriter]:
    """Open a writer for the MP4 file `path`, which appears when the block ends well and not at all when it raises.

    `quality` is x264's constant rate factor: less is better and larger.
    """
    path = Path(path)
    try:
        with atomic_path(path) as temporary, av.open(str(temporary), "w", format="mp4") as container:
            writer = VideoWriter(container, path, quality)
            yield writer
            writer.finish()
    except OSError as error:
        raise InputError(f"The video {path} cannot be written ({error.strerror or error}).") from error


def write_overlay_video(
    path: str | os.PathLike[str], frames: Iterable[tuple[float, UInt8[np.ndarray, "height width 3"]]]
) -> Path:
    """Write `(seconds, RGB image)` pairs as H.264, one at a time, keeping their times; returns the path."""
    with open_video(path) as writer:
        for seconds, image in frames:
            writer.write(seconds, image)
    return Path(path)
