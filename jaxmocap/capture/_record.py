"""What a capture is: its videos as `capture.toml` names them, matched in time, and the cameras that filmed them."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Self

import numpy as np
from jaxtyping import Bool, Float64, Int64

from jaxmocap._results import InputError
from jaxmocap.camera import Cameras, read_cameras
from jaxmocap.detection import LayoutName

from ._config import CaptureConfig, Finding
from ._picture_steps import Reduction, Turn, Undistortion, reduced_size
from ._span import selected_positions, shared_frames, span_of
from ._video import VideoIndex

_METRES = {"metres": 1.0, "centimetres": 0.01, "millimetres": 0.001}


@dataclass(frozen=True, eq=False)
class CaptureRecord:
    """What is known of a capture before any picture is decoded; `Capture` reads the files that it names.

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

    @classmethod
    def from_config(cls, file: Path, config: CaptureConfig, indices: list[VideoIndex], findings: list[Finding]) -> Self:
        """Assemble a capture from what its file says and the videos indexed; `findings` are warnings met before."""
        folder = file.parent
        offsets = tuple(entry.offset for entry in config.camera)
        shared = shared_frames(indices, offsets)
        num_frames, about_frames = span_of(config, file, shared, indices)
        selected, about_selected = selected_positions(config, file, int(shared[0, 0]), num_frames)

        def inside(value: str | None) -> Path | None:
            return None if value is None else folder / value

        return cls(
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

    def _steps(self, camera_index: int) -> list[Reduction | Undistortion | Turn]:
        """From the recorded video to the pictures: smaller, then undistorted, then turned."""
        steps = (self._reductions[camera_index], self._undistortions[camera_index])
        turn = [Turn(self._filmed_sizes[camera_index][0])] if self.turned and self.turned[camera_index] else []
        return [*(step for step in steps if step is not None), *turn]
