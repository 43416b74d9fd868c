"""One recording of a public data set, and how it becomes a capture."""

import json
import shutil
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import cv2
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, UInt8

from jaxmocap._files import atomic_folder, npz_bytes
from jaxmocap._results import InputError
from jaxmocap.camera import Cameras, write_cameras
from jaxmocap.capture import index_video
from jaxmocap.viewers import open_video

_PICTURES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".ppm")


@dataclass(frozen=True)
class StaticCalibration:
    """A camera that does not move.

    Attributes:
        intrinsics: pixels, the centre of the first pixel at (0, 0).
        distortion: k1 k2 p1 p2 k3, as OpenCV has them.
        rotation: from the world to the camera.
        translation: from the world to the camera, metres.
    """

    intrinsics: Float[np.ndarray, "3 3"]
    distortion: Float[np.ndarray, "5"]
    rotation: Float[np.ndarray, "3 3"]
    translation: Float[np.ndarray, "3"]


@dataclass(frozen=True)
class RecordedCamera:
    """What one camera recorded.

    Attributes:
        name: of the camera.
        pictures: a video, or a folder of images.
        calibration: of the camera.
        offset: when it began, seconds, added to its own time; 0 by default.
    """

    name: str
    pictures: Path
    calibration: StaticCalibration
    offset: float = 0.0


@dataclass(frozen=True)
class RecordedSequence:
    """What a reader finds.

    Attributes:
        name: of the capture that it becomes.
        fps: frames per second.
        up: the world's vertical axis, "y" or "z".
        cameras: and what they recorded.
        markers: metres in the world, NaN where not seen; None where there are none.
        times: of markers and joints, seconds of the first camera.
        actor: the subject's mesh; None where there is none.
        joints: joint centres, metres in the world, NaN where not known; None where there are none.
        joint_names: their names, ours where they are the same joint.
        span: the frames (start, stop) of the pictures that are this sequence; all by default.
        note: what to know about it, a sentence or two; nothing by default.
    """

    name: str
    fps: float
    up: str
    cameras: tuple[RecordedCamera, ...]
    markers: Float[np.ndarray, "sample marker 3"] | None = None
    times: Float[np.ndarray, " sample"] | None = None
    actor: Path | None = None
    joints: Float[np.ndarray, "sample joint 3"] | None = None
    joint_names: tuple[str, ...] = ()
    span: tuple[int, int] | None = None
    note: str = ""


def write_sequence(sequence: RecordedSequence, out: Path, frames: tuple[int, int] | None = None) -> Path:
    """Write the recording as a capture folder, whole or not at all; return `out`.

    It holds videos (copied; folders of images and cut ones encoded with hardly any loss), static cameras, truth, and
    `capture.toml`. `frames` (start, stop) takes a part. Raises `InputError` where `out` holds something already,
    or `frames` begin behind the last one.
    """
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise InputError(f"{out} exists already; choose a new folder for the capture.")
    if frames is not None:
        _check_begin(sequence, frames[0])
    start = 0.0 if frames is None else frames[0] / sequence.fps
    if sequence.span is not None:
        first, stop = frames if frames is not None else (0, sequence.span[1] - sequence.span[0])
        frames = (sequence.span[0] + first, min(sequence.span[0] + stop, sequence.span[1]))
    with atomic_folder(out) as folder:
        entries, sizes = [], []
        for camera in sequence.cameras:
            name = _write_pictures(camera, sequence.fps, frames, folder)
            sizes.append(index_video(folder / name).size)
            named = f"name = {_quoted(camera.name)}\nvideo = {_quoted(name)}"
            entries.append(f"[[camera]]\n{named}\noffset = {camera.offset:.6f}\n")
        cameras = _cameras(sequence, sizes)
        write_cameras(cameras, folder / "cameras.toml", "aniposelib")
        lines = [
            f"name = {_quoted(sequence.name)}",
            f"fps = {sequence.fps:g}",
            'units = "metres"',
            f'up = "{sequence.up}"',
        ]
        lines.append('cameras = "cameras.toml"')
        if sequence.actor is not None:
            shutil.copyfile(sequence.actor, folder / f"actor{sequence.actor.suffix}")
            lines.append(f'actor = "actor{sequence.actor.suffix}"')
        if sequence.times is not None:
            kept = sequence.times >= start - 1e-9
            truth: dict[str, np.ndarray] = {"timestamps": sequence.times[kept] - start}
            if sequence.markers is not None:
                truth["markers"] = sequence.markers[kept]
            if sequence.joints is not None:
                truth |= {"joints": sequence.joints[kept], "joint_names": np.array(sequence.joint_names)}
            (folder / "truth.npz").write_bytes(npz_bytes(truth))
            lines.append('truth = "truth.npz"')
        (folder / "capture.toml").write_text("\n".join([*lines, "", *entries]), encoding="utf-8")
    return out


def _check_begin(sequence: RecordedSequence, first: int) -> None:
    for camera in sequence.cameras:
        pictures = camera.pictures
        count = len(sorted_pictures(pictures)) if pictures.is_dir() else index_video(pictures).num_frames
        if sequence.span is not None:
            count = min(count, sequence.span[1]) - sequence.span[0]
        if first >= count:
            of = "" if sequence.span is None else f" of {sequence.name}"
            raise InputError(f"--frames begins at {first}, but {pictures} has {count} frames{of}.")


def _quoted(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)


def _cameras(sequence: RecordedSequence, sizes: list[tuple[int, int]]) -> Cameras:
    count = len(sequence.cameras)
    poses, intrinsics = np.tile(np.eye(4), (count, 1, 1, 1)), np.zeros((count, 3, 3))
    for index, camera in enumerate(sequence.cameras):
        poses[index, 0, :3, :3] = camera.calibration.rotation
        poses[index, 0, :3, 3] = camera.calibration.translation
        intrinsics[index] = camera.calibration.intrinsics
        intrinsics[index, :2, 2] += 0.5
    distortion = np.stack([camera.calibration.distortion for camera in sequence.cameras])
    return Cameras(
        names=tuple(camera.name for camera in sequence.cameras),
        sizes=tuple(sizes),
        intrinsics=jnp.asarray(intrinsics, jnp.float32),
        distortion=jnp.asarray(distortion, jnp.float32),
        cam_from_world=jnp.asarray(poses, jnp.float32),
    )


def _write_pictures(camera: RecordedCamera, fps: float, frames: tuple[int, int] | None, folder: Path) -> str:
    if camera.pictures.is_file() and frames is None:
        shutil.copyfile(camera.pictures, folder / f"{camera.name}{camera.pictures.suffix}")
        return f"{camera.name}{camera.pictures.suffix}"
    name, rate = f"{camera.name}.mp4", Fraction(fps).limit_denominator(1001)
    with open_video(folder / name, quality=4) as writer:
        for number, image in enumerate(_images(camera.pictures, frames)):
            writer.write(float(number / rate), image)
    return name


def _images(pictures: Path, frames: tuple[int, int] | None) -> Iterator[UInt8[np.ndarray, "height width 3"]]:
    first, stop = frames if frames is not None else (0, None)
    if pictures.is_dir():
        for path in sorted_pictures(pictures)[first:stop]:
            image = cv2.imread(str(path))
            if image is None:
                raise InputError(f"the picture {path} cannot be read.")
            yield image[..., ::-1]
        return
    video = cv2.VideoCapture(str(pictures))
    number = 0
    while stop is None or number < stop:
        done, image = video.read()
        if not done:
            break
        if number >= first:
            yield image[..., ::-1]
        number += 1
    video.release()


def sorted_pictures(folder: Path) -> list[Path]:
    """List the images of a folder by the last number in their names. Raises `InputError` where there are none."""
    found = [path for path in folder.iterdir() if path.suffix.lower() in _PICTURES]
    if not found:
        raise InputError(f"the folder {folder} holds no pictures ({', '.join(_PICTURES)}).")

    def number(path: Path) -> tuple[int, str]:
        digits = "".join(c if c.isdigit() else " " for c in path.stem).split()
        return (int(digits[-1]) if digits else -1, path.name)

    return sorted(found, key=number)


def named(found: Sequence[str], wanted: str | None, where: Path) -> str:
    """Choose the sequence asked for, or the only one there is. Raises `InputError` where it is not there."""
    if wanted is None and len(found) == 1:
        return found[0]
    if wanted is None or wanted not in found:
        said = "none is asked for" if wanted is None else f"'{wanted}' is not there"
        raise InputError(f"{where} holds {', '.join(found) or 'no sequence'}; {said}: name one with --sequence.")
    return wanted
