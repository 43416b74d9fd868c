"""A capture: synchronised videos of one person, with cameras, keypoints and masks where they exist."""

import contextlib
import itertools
import threading
from collections import OrderedDict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float64, Int64, UInt8

from jaxmocap._results import InputError
from jaxmocap.camera import Cameras, read_cameras
from jaxmocap.detection import BODY_25, LayoutName, VideoKeypoints, best_person

from ._config import CaptureConfig, Finding, config_path, missing_files, read_config, selected_positions, span_of
from ._picture_steps import Reduction, Turn, Undistortion, mask_file, read_mask, reduced_size, turns
from ._video import FrameReader, VideoIndex, index_video, shared_frames

KEYPOINT_NAMES = tuple("pelvis" if name == "mid_hip" else name for name in BODY_25.points)
"""The points that `Capture.keypoints` gives."""

SILHOUETTES = "silhouettes"
"""Folder in that of the keypoints: where a detector sees the person, one mask per picture."""

_METRES = {"metres": 1.0, "centimetres": 0.01, "millimetres": 0.001}
_CACHED_IMAGES = 8
_OPENED = ("timestamps", "cameras", "_calibrated", "_reductions", "_undistortions", "_random_access")


@dataclass(frozen=True, eq=False)
class Capture:
    """Videos of one person, opened and matched in time. A host record; images are decoded when asked for.

    A `frame` in every method is a position 0 .. num_frames-1 in the span all cameras share, the same as in
    `cameras.at(frame)` and `timestamps[frame]`. Whatever a capture gives is of `sizes`.

    Attributes:
        folder: where `capture.toml` is.
        name: for reports.
        fps: nominal frames per second.
        num_frames: frames that all cameras share.
        up: the world's vertical axis, "x", "y" or "z".
        metres_per_unit: of the calibration's lengths.
        actor: file of the character; None: not given.
        camera_names: one per camera, by which files are named.
        videos: one file per camera.
        selected_frames: positions of the frames to register (Gamma, paper Sec. 3); None: chosen by `choose_frames`.
        masks_folder: PNG masks by camera and frame; None: not given.
        keypoints_folder: a detector's files (`jaxmocap.detection`) by camera and frame; None: not given.
        truth: file of the true motion; None: not known.
        cameras_path: COLMAP model or calibration file; None: not calibrated.
        offsets: seconds added to each video's own time to give the common time.
        indices: what each video holds.
        video_frames: number of each frame in that camera's own video, by which files are named; row 0 numbers a result.
        findings: warnings met while opening.
        found_masks: (camera, frame) -> undistorted mask, in the place of mask files that are missing (`with_masks`).
        longest_side: pixels; longer pictures are made smaller when decoded, and masks, keypoints and cameras with them;
            None: never.
        keypoint_layout: of the keypoint files; None: told by the number of points.
        turned: cameras whose pictures, masks, keypoints and poses are turned by a quarter (`one_way_up`); none: ().
    """

    folder: Path
    name: str
    fps: float
    num_frames: int
    up: str
    metres_per_unit: float
    actor: Path | None
    camera_names: tuple[str, ...]
    videos: tuple[Path, ...]
    selected_frames: tuple[int, ...] | None
    masks_folder: Path | None
    keypoints_folder: Path | None
    truth: Path | None
    cameras_path: Path | None
    offsets: tuple[float, ...]
    indices: tuple[VideoIndex, ...]
    video_frames: Int64[np.ndarray, "camera frame"]
    findings: tuple[Finding, ...] = ()
    found_masks: Mapping[tuple[int, int], Bool[np.ndarray, "height width"]] = field(default_factory=dict)
    longest_side: int | None = None
    keypoint_layout: LayoutName | None = None
    turned: tuple[bool, ...] = ()

    @staticmethod
    def open(path: str | Path, *, with_cameras: bool = True, longest_side: int | None = None) -> "Capture":
        """Open a capture folder, or its `capture.toml`.

        Without cameras, whatever it says about them is not looked at, and images, masks and keypoints are as recorded.

        Pictures longer than `longest_side` pixels are made smaller; by default what `capture.toml` says, or else 960,
        as the paper's Sec. 5 makes 1920 x 1080 to 960 x 540.

        Raises `InputError` naming the file, camera or frame for anything that makes the capture unusable; `check`
        lists everything at once.
        """
        if longest_side is not None and (longest_side < 64 or longest_side % 2):
            raise InputError(f"longest_side is {longest_side}; an even number of at least 64 pixels was expected.")
        file = config_path(path)
        config, findings = read_config(file)
        if config is None:
            raise InputError(next(finding.message for finding in findings if finding.severity == "error"))
        if not with_cameras:
            config = config.model_copy(update={"cameras": None})
        capture = build(file, config, [index_video(file.parent / entry.video) for entry in config.camera], findings)
        if with_cameras:
            capture = replace(capture, longest_side=longest_side or config.longest_side)
        for _, missing in missing_files(file, config):
            raise InputError(missing)
        if capture.cameras_path is not None:
            _ = capture.cameras
        return capture

    @property
    def num_cameras(self) -> int:
        return len(self.camera_names)

    @property
    def sizes(self) -> tuple[tuple[int, int], ...]:
        """(width, height) of each camera's pictures, in pixels."""
        sizes, turned = self._filmed_sizes, self.turned or (False,) * self.num_cameras
        return tuple((h, w) if turn else (w, h) for (w, h), turn in zip(sizes, turned, strict=True))

    @property
    def _filmed_sizes(self) -> tuple[tuple[int, int], ...]:
        """As `sizes`, before any are turned."""
        return tuple(reduced_size(size, self.longest_side) for size in self.recorded_sizes)

    @property
    def recorded_sizes(self) -> tuple[tuple[int, int], ...]:
        """(width, height) of each video as displayed."""
        return tuple(index.size for index in self.indices)

    @cached_property
    def timestamps(self) -> Float64[np.ndarray, " frame"]:
        """Presentation time of each frame in seconds since the first frame of the first camera's video."""
        return self.indices[0].seconds[self.video_frames[0]]

    @cached_property
    def cameras(self) -> Cameras:
        """The calibrated cameras over the shared frames, in metres. Raises `InputError` if there are none."""
        return self._calibrated.turned(self.turned)

    @cached_property
    def _calibrated(self) -> Cameras:
        """As `cameras`, before any are turned."""
        if self.cameras_path is None:
            raise InputError(
                f"capture {self.folder} has no cameras: calibrate it first (jaxmocap calibrate {self.folder}), or name "
                "a COLMAP model or a calibration file as cameras in capture.toml"
            )
        sizes, path = self.recorded_sizes, self.cameras_path
        cameras = read_cameras(path, self.camera_names, self.num_frames, sizes, self.video_frames, self.metres_per_unit)
        return cameras.resized(self._filmed_sizes)

    @cached_property
    def _reductions(self) -> tuple[Reduction | None, ...]:
        sizes = zip(self.recorded_sizes, self._filmed_sizes, strict=True)
        return tuple(Reduction(recorded, size) if recorded != size else None for recorded, size in sizes)

    @cached_property
    def _undistortions(self) -> tuple[Undistortion | None, ...]:
        if self.cameras_path is None:
            return (None,) * self.num_cameras
        intrinsics, distortion = np.asarray(self._calibrated.intrinsics), np.asarray(self._calibrated.distortion)
        return tuple(
            Undistortion(k, d, size) if d.any() else None
            for k, d, size in zip(intrinsics, distortion, self._filmed_sizes, strict=True)
        )

    def _own_frame(self, camera_index: int, frame: int) -> int:
        if not isinstance(camera_index, int | np.integer) or not 0 <= camera_index < self.num_cameras:
            raise IndexError(f"camera {camera_index!r} is none of 0..{self.num_cameras - 1}")
        if not 0 <= frame < self.num_frames:
            raise IndexError(f"frame {frame} is outside 0..{self.num_frames - 1}")
        return int(self.video_frames[camera_index, frame])

    def frames(
        self, start: int = 0, stop: int | None = None
    ) -> Iterator[tuple[int, list[UInt8[np.ndarray, "height width 3"]]]]:
        """Yield `(frame, one RGB image per camera)` for start <= frame < stop, undistorted, decoding as it goes.

        The cameras run in lockstep and only the current images are held, however long the videos are.
        """
        stop = self.num_frames if stop is None else stop
        if not 0 <= start <= stop <= self.num_frames:
            raise IndexError(f"frames {start}:{stop} are outside 0:{self.num_frames}")
        readers: list[FrameReader] = []
        try:
            readers.extend(FrameReader(index) for index in self.indices)
            for frame in range(start, stop):
                yield frame, [self._read(camera, reader, frame) for camera, reader in enumerate(readers)]
        finally:
            for reader in readers:
                reader.close()

    def _read(self, camera_index: int, reader: FrameReader, frame: int) -> UInt8[np.ndarray, "height width 3"]:
        image = reader.read(self._own_frame(camera_index, frame))
        for step in self._steps(camera_index):
            image = step.image(image)
        return image

    def _steps(self, camera_index: int) -> list[Reduction | Undistortion | Turn]:
        """From the recorded video to the pictures: smaller, then undistorted, then turned."""
        steps = (self._reductions[camera_index], self._undistortions[camera_index])
        turn = [Turn(self._filmed_sizes[camera_index][0])] if self.turned and self.turned[camera_index] else []
        return [*(step for step in steps if step is not None), *turn]

    @cached_property
    def _random_access(self) -> "_RandomAccess":
        return _RandomAccess(self.indices)

    def image(self, camera_index: int, frame: int) -> UInt8[np.ndarray, "height width 3"]:
        """Decode one image, RGB, undistorted; any order. The last few are kept. Treat it as read-only.

        Cameras and frames count from 0; others raise `IndexError`.
        """
        access = self._random_access
        with access.lock:
            key = (camera_index, frame)
            if key not in access.images:
                self._own_frame(camera_index, frame)  # says what is wrong with either
                image = self._read(camera_index, access.reader(camera_index), frame)
                image.flags.writeable = False
                access.images[key] = image
                if len(access.images) > _CACHED_IMAGES:
                    access.images.popitem(last=False)
            access.images.move_to_end(key)
            return access.images[key]

    def look_ahead(self, frames: Sequence[int]) -> None:
        """Begin to decode the first of these frames, as many as are kept, in a thread.

        What goes wrong there is said when they are asked for.
        """
        pairs = list(itertools.product(frames, range(self.num_cameras)))[:_CACHED_IMAGES]
        _ = self._random_access  # which copies of this capture share

        def decode() -> None:
            with contextlib.suppress(InputError, OSError):
                for frame, camera in pairs:
                    self.image(camera, frame)

        threading.Thread(target=decode, name="frames ahead").start()

    def mask(self, camera_index: int, frame: int) -> Bool[np.ndarray, "height width"] | None:
        """Read the person's mask, undistorted like the image; None if there is none for this camera and frame."""
        own = self._own_frame(camera_index, frame)
        found = self.found_masks.get((camera_index, frame))
        if found is not None or self.masks_folder is None:
            return found
        return self._read_mask(self.masks_folder, camera_index, own)

    def silhouette(self, camera_index: int, frame: int) -> Bool[np.ndarray, "height width"] | None:
        """Read where a detector sees the person, undistorted like the image; None if it has not said.

        Less exact than a mask: it says roughly where masks are to be found.
        """
        folder = self.silhouettes_folder
        return None if folder is None else self._read_mask(folder, camera_index, self._own_frame(camera_index, frame))

    @property
    def silhouettes_folder(self) -> Path | None:
        """PNG files of the person in every picture, `SILHOUETTES` in the keypoints' folder; None without keypoints."""
        return None if self.keypoints_folder is None else self.keypoints_folder / SILHOUETTES

    def _read_mask(self, folder: Path, camera_index: int, own: int) -> Bool[np.ndarray, "height width"] | None:
        file = mask_file(folder, self.camera_names[camera_index], own)
        if not file.is_file():
            return None
        mask = read_mask(file, self.recorded_sizes[camera_index])
        for step in self._steps(camera_index):
            mask = step.mask(mask)
        return mask

    def with_masks(self, masks: Mapping[int, Sequence[Bool[np.ndarray, "height width"] | None]]) -> "Capture":
        """Return the same capture with masks that were found: frame -> one undistorted mask, or None, per camera."""
        found = {(camera, frame): m for frame, row in masks.items() for camera, m in enumerate(row) if m is not None}
        return self._with(found_masks={**self.found_masks, **found})

    def with_selected_frames(self, frames: Sequence[int]) -> "Capture":
        """Return the same capture with these selected frames (positions)."""
        return self._with(selected_frames=tuple(sorted(set(frames))))

    def with_keypoints_folder(self, folder: Path) -> "Capture":
        """Return the same capture with keypoints from this folder."""
        return self._with(keypoints_folder=folder)

    def as_recorded(self) -> "Capture":
        """Return the same capture with pictures, masks, keypoints and cameras of the videos' own sizes."""
        return replace(self, longest_side=None, found_masks={}, turned=())

    def one_way_up(self) -> "Capture":
        """Return the same capture with the pictures of some cameras turned by a quarter, and all that belongs to them.

        Tracking looks at a rectangle that has one size in all views, for which narrow pictures beside low ones leave
        little. It is the capture itself where all cameras were held the same way.
        """
        turned = turns(self._filmed_sizes)
        if self.turned or not any(turned):
            return self
        masks = {
            (camera, frame): Turn(mask.shape[1]).mask(mask) if turned[camera] else mask
            for (camera, frame), mask in self.found_masks.items()
        }
        copy = replace(self, turned=turned, found_masks=masks)
        copy.__dict__.update({name: self.__dict__[name] for name in _OPENED if name in self.__dict__})
        for name in ("cameras", "_random_access"):  # whose pictures are not turned
            copy.__dict__.pop(name, None)
        return copy

    def as_filmed(
        self, camera_index: int, picture: UInt8[np.ndarray, "height width 3"]
    ) -> UInt8[np.ndarray, "rows columns 3"]:
        """Turn a picture of this capture back the way its camera was held."""
        return np.rot90(picture, -1) if self.turned and self.turned[camera_index] else picture

    def cameras_as_filmed(self, cameras: Cameras) -> Cameras:
        """Turn cameras of this capture's pictures back the way they were held, with the videos' distortion."""
        if not self.turned:
            return cameras
        for _ in range(3):
            cameras = cameras.turned(self.turned)
        return replace(cameras, distortion=self._calibrated.distortion)

    def _with(self, **changes: Any) -> "Capture":
        """Make a changed copy that shares the cameras read and the videos opened."""
        copy = replace(self, **changes)
        opened = {name: self.__dict__[name] for name in _OPENED if name in self.__dict__}
        copy.__dict__.update(opened)
        return copy

    def recorded_mask(
        self, camera_index: int, mask: Bool[np.ndarray, "lower narrower"]
    ) -> Bool[np.ndarray, "height width"]:
        """Warp an undistorted mask to the recorded video, which is how mask files hold it."""
        for step in reversed(self._steps(camera_index)):
            mask = step.recorded_mask(mask)
        return mask

    def keypoints(self, camera_index: int, frame: int) -> Float64[np.ndarray, "25 3"] | None:
        """Read BODY_25 points x, y, confidence in the undistorted image; None without a file or a person.

        Of several people the one of the largest mean confidence is taken. Points not found have confidence 0.
        """
        return best_person(self.people(camera_index, frame))

    def people(self, camera_index: int, frame: int, folder: Path | None = None) -> list[Float64[np.ndarray, "25 3"]]:
        """Read everybody in a keypoint file as `keypoints` does; from another folder than the capture's if asked."""
        own = self._own_frame(camera_index, frame)
        source = self.video_keypoints(camera_index, folder)
        people = [] if source is None else source.people(own)
        for step in self._steps(camera_index):
            for points in people:
                found = points[:, 2] > 0
                points[found, :2] = step.points(points[found, :2])
        return people

    def keypoint_frames(self, camera_index: int) -> tuple[int, ...]:
        """List the frames for which this camera has keypoints on file, be it that they show nobody."""
        source, own = self.video_keypoints(camera_index), self.video_frames[camera_index]
        return () if source is None else tuple(i for i in range(self.num_frames) if source.has(int(own[i])))

    def video_keypoints(self, camera_index: int, folder: Path | None = None) -> VideoKeypoints | None:
        """Find the files of one video in the keypoints folder, or in another; None without a folder.

        Files may bear the video's name instead of the camera's where it is no other video's or camera's.
        """
        folder = self.keypoints_folder if folder is None else folder
        if folder is None:
            return None
        name, stem = self.camera_names[camera_index], self.videos[camera_index].stem
        alone = stem not in self.camera_names and [video.stem for video in self.videos].count(stem) == 1
        names = (name, stem) if alone else (name,)
        return VideoKeypoints(folder, names, self.keypoint_layout, self.recorded_sizes[camera_index])


class _RandomAccess:
    """One open reader per camera and the last images, behind a lock."""

    def __init__(self, indices: tuple[VideoIndex, ...]):
        self.lock = threading.Lock()
        self.images: OrderedDict[tuple[int, int], UInt8[np.ndarray, "height width 3"]] = OrderedDict()
        self._indices = indices
        self._readers: dict[int, FrameReader] = {}

    def reader(self, camera_index: int) -> FrameReader:
        if camera_index not in self._readers:
            self._readers[camera_index] = FrameReader(self._indices[camera_index])
        return self._readers[camera_index]


def build(file: Path, config: CaptureConfig, indices: list[VideoIndex], findings: list[Finding]) -> Capture:
    """Assemble a capture from its configuration and indexed videos."""
    folder = file.parent
    offsets = tuple(entry.offset for entry in config.camera)
    shared = shared_frames(indices, offsets)
    num_frames, about_frames = span_of(config, file, shared, indices)
    selected, about_selected = selected_positions(config, file, int(shared[0, 0]), num_frames)

    def inside(value: str | None) -> Path | None:
        return None if value is None else folder / value

    return Capture(
        folder=folder,
        name=config.name or folder.resolve().name,
        fps=config.fps or (1 / indices[0].interval if indices[0].interval > 0 else 30.0),
        num_frames=num_frames,
        up=config.up,
        metres_per_unit=_METRES[config.units],
        actor=inside(config.actor),
        camera_names=tuple(entry.name for entry in config.camera),
        videos=tuple(folder / entry.video for entry in config.camera),
        selected_frames=selected,
        masks_folder=inside(config.masks),
        keypoints_folder=inside(config.keypoints),
        truth=inside(config.truth),
        cameras_path=inside(config.cameras),
        offsets=offsets,
        indices=tuple(indices),
        video_frames=shared[:, :num_frames],
        findings=(*findings, *about_frames, *about_selected),
        keypoint_layout=config.keypoint_layout,
    )
