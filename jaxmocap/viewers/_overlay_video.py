"""A result over the videos it was tracked in."""

import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from jaxmocap._results import InputError
from jaxmocap.camera import Cameras
from jaxmocap.capture import Capture
from jaxmocap.character import Character
from jaxmocap.motion import Motion

from ._overlay import OverlayStyle, draw_overlay
from ._video import write_overlay_video


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
    """One overlay video per view, `overlay_<camera>.mp4` in `folder`."""
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
    """Yield `(seconds, RGB image with the tracked body)` for every frame of a motion in one view."""
    intrinsics = np.asarray(cameras.intrinsics)[camera_index]
    cam_from_world = np.asarray(cameras.cam_from_world)[camera_index]
    faces = np.asarray(character.faces)
    for index, position in enumerate(positions_in_capture(capture, motion)):
        image = draw_overlay(
            capture.image(camera_index, position),
            motion.vertices(index),
            faces,
            intrinsics,
            cam_from_world[position],
            joints=motion.joints[index],
            joint_names=motion.joint_names,
            confidence=motion.confidence[index],
            status=str(motion.status[index]),
            label=f"{cameras.names[camera_index]}  frame {motion.frames[index]}  {motion.timestamps[index]:.2f} s",
            style=style,
        )
        yield float(motion.timestamps[index]), image


def positions_in_capture(capture: Capture, motion: Motion) -> list[int]:
    """Where the motion's frames are in the capture: a result counts as the first camera's video does, a capture counts
    the frames all cameras share. `InputError` for a frame the capture does not have."""
    positions = {int(frame): position for position, frame in enumerate(capture.video_frames[0])}
    missing = [frame for frame in motion.frames.tolist() if frame not in positions]
    if missing:
        raise InputError(
            f"Frame {missing[0]} of the result is not among the frames that all cameras of {capture.folder} share "
            f"({capture.video_frames[0, 0]} to {capture.video_frames[0, -1]}); is it the result of another capture?"
        )
    return [positions[frame] for frame in motion.frames.tolist()]
