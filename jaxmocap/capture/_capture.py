"""A capture: synchronised videos of one person, with cameras, keypoints and masks where they exist."""

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float64, UInt8

from jaxmocap._results import InputError
from jaxmocap.camera import Cameras
from jaxmocap.detection import BODY_25, VideoKeypoints, best_person

from ._config import config_path, missing_files, read_config
from ._picture_steps import Turn, mask_file, read_mask, turns
from ._random_access import CACHED_IMAGES, RandomAccess, decode_ahead
from ._record import CaptureRecord
from ._video import FrameReader, index_video

KEYPOINT_NAMES = tuple("pelvis" if name == "mid_hip" else name for name in BODY_25.points)
"""The points that `Capture.keypoints` gives."""

SILHOUETTES = "silhouettes"
"""Folder in that of the keypoints: where a detector sees the person, one mask per picture."""

_OPENED = ("timestamps", "cameras", "_calibrated", "_reductions", "_undistortions", "_random_access")


@dataclass(frozen=True, eq=False)
class Capture(CaptureRecord):
    """Videos of one person, opened and matched in time. A host record; images are decoded when asked for.

    A `frame` in every method is a position 0 .. num_frames-1 in the span all cameras share, the same as in
    `cameras.at(frame)` and `timestamps[frame]`. Whatever a capture gives is of `sizes`. Its attributes are those of
    `CaptureRecord`.
    """

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
        capture = Capture.from_config(
            file, config, [index_video(file.parent / entry.video) for entry in config.camera], findings
        )
        if with_cameras:
            capture = replace(capture, longest_side=longest_side or config.longest_side)
        for _, missing in missing_files(file, config):
            raise InputError(missing)
        if capture.cameras_path is not None:
            _ = capture.cameras
        return capture

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

    @cached_property
    def _random_access(self) -> RandomAccess:
        return RandomAccess(self.indices)

    def image(self, camera_index: int, frame: int) -> UInt8[np.ndarray, "height width 3"]:
        """Decode one image, RGB, undistorted; any order. The last few are kept. Treat it as read-only.

        Cameras and frames count from 0; others raise `IndexError`.
        """
        self._own_frame(camera_index, frame)  # says what is wrong with either
        return self._random_access.image(camera_index, frame, lambda reader: self._read(camera_index, reader, frame))

    def look_ahead(self, frames: Sequence[int]) -> None:
        """Begin to decode the first of these frames, as many as are kept, in a thread.

        What goes wrong there is said when they are asked for.
        """
        pairs = [(camera, frame) for frame, camera in itertools.product(frames, range(self.num_cameras))]
        _ = self._random_access  # which copies of this capture share
        decode_ahead(self.image, pairs[:CACHED_IMAGES])

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
