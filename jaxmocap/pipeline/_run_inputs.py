"""A run in its folder, and what its stages are made of."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from jaxmocap._results import InputError
from jaxmocap._types import Report, Say
from jaxmocap.calibration import refuse_gaps
from jaxmocap.capture import Capture, CaptureConfig, VideoIndex, camera_names, config_path, path_hash, read_config

from ._run_files import examine_files
from ._run_options import RunOptions, examine
from ._run_record import RunRecord

CAPTURE = "capture"
"""Folder of a run in which its capture lies."""


def names_in(capture: Path, videos: Sequence[Path]) -> list[str]:
    """Name the cameras as an earlier run's capture does; where there is none of as many, like their videos."""
    config = _config_in(capture)
    if config is None or len(config.camera) != len(videos):
        return camera_names(videos)
    return [camera.name for camera in config.camera]


def _config_in(capture: Path) -> CaptureConfig | None:
    file = capture / "capture.toml"
    return read_config(file)[0] if file.is_file() else None


def examine_in(out: Path, videos: Sequence[str | Path], options: RunOptions) -> tuple[list[VideoIndex], RunOptions]:
    """Examine a run in a folder: the videos opened, and the options by the names that its cameras have.

    In the options a camera may also be called like its video is now. Raises `InputError`, as `examine` and
    `examine_files`.
    """
    paths = [Path(video) for video in videos]
    names = names_in(out / CAPTURE, paths)
    options = options.renamed(dict(zip(camera_names(paths), names, strict=True)))
    indices, config = examine(paths, options, names), _config_in(out / CAPTURE)
    examine_files(options, indices, names, None if config is None else config.keypoint_layout)
    return indices, options


@dataclass(frozen=True)
class RunInputs:
    """A run: its videos and options, its folder, and whom to tell.

    Attributes:
        indices: the videos.
        out: folder of the run.
        options: what it is told.
        record: what it has done.
        say: takes sentences.
        progress: takes stage, steps done and steps in all.
    """

    indices: Sequence[VideoIndex]
    out: Path
    options: RunOptions
    record: RunRecord
    say: Say
    progress: Report

    @property
    def folder(self) -> Path:
        return self.out / CAPTURE

    @property
    def several(self) -> bool:
        return len(self.indices) > 1

    @property
    def names(self) -> list[str]:
        return names_in(self.folder, [index.path for index in self.indices])

    @cached_property
    def videos(self) -> list[str]:
        """Hashes of the videos."""
        return [path_hash(index.path) for index in self.indices]

    def config(self) -> CaptureConfig:
        """Read `capture.toml` as it is now. Raises `InputError` where somebody has spoilt it."""
        config, findings = read_config(config_path(self.folder))
        if config is None:
            raise InputError(next(finding.message for finding in findings if finding.severity == "error"))
        return config

    def hash_of(self, line: str) -> str | None:
        """Hash what a line of `capture.toml` names; None where it names nothing, or nothing is there."""
        named = getattr(self.config(), line)
        path = None if named is None else self.folder / named
        return None if path is None or not path.exists() else path_hash(path)

    def offsets(self) -> list[float]:
        """Read when the videos began, seconds."""
        return [camera.offset for camera in self.config().camera]

    def of_synchronise(self) -> Any:
        """List what offsets are made of."""
        told = self.options.offset
        return [self.videos, sorted(told.items())] if told else self.videos

    def of_person(self) -> Any:
        """List what says whose keypoints they are, whenever the videos began."""
        options = self.options
        given = None if options.keypoints is None else path_hash(options.keypoints)
        weights = None if options.weights is None else str(options.weights)
        return [self.videos, given, weights, sorted(options.person.items())]

    def of_detect(self) -> Any:
        """List what keypoints are made of."""
        return [*self.of_person(), self.offsets(), self.config().frames]

    def of_calibrate(self) -> Any:
        """List what cameras are made of."""
        options = self.options
        size = self.of_body() if options.body_first and options.camera_distance is None else None
        told = [options.height, options.camera_distance, sorted(options.focal.items()), options.static, options.seed]
        config = self.config()
        read = [self.hash_of("keypoints"), config.keypoint_layout, config.frames]
        return [self.videos, self.offsets(), read, size, told, self.lost_in_span()]

    def calibration(self) -> dict[str, Any] | None:
        """Read what `calibrate` wrote about the cameras that there are; None without."""
        named = self.config().cameras
        report = None if named is None else self.folder / named / "calibration.json"
        if report is None or not report.is_file():
            return None
        return json.loads(report.read_text(encoding="utf-8"))

    def lost_in_span(self) -> bool:
        """Say whether the cameras that there are have a gap in the frames that are wanted, as those of others may."""
        found = self.calibration()
        if found is None:
            return False
        lost = {
            (number, frame)
            for number, camera in enumerate(found["cameras"].values())
            for frame in camera["interpolated"]
        }
        try:
            refuse_gaps(Capture.open(self.folder, with_cameras=False), lost, self.options.frames)
        except InputError:
            return True
        return False

    def scale_from_height(self) -> bool:
        """Tell whether the person's height is all that tells the scale of the cameras, which are of this run."""
        found = self.calibration()
        own = self.config().cameras == self.record.made("calibrate")
        if found is None or not own or self.options.height is None:
            return False
        return found["scale"]["from"] in ("height", "height and outlines")

    def of_select(self) -> Any:
        """List what the selected frames are chosen from."""
        return [self.seen(), self.options.frames]

    def of_body(self) -> Any:
        """List what the body is made of."""
        options = self.options
        if options.actor is not None:
            return [path_hash(options.actor), options.height]
        scanned = [] if options.scan is None else [path_hash(options.scan)]
        if options.body_first:
            return [*scanned, options.height, options.seed]
        return [*scanned, self.seen(), options.height, options.frames, options.seed]

    def seen(self) -> Any:
        """List what is known of the person and the cameras, and how `capture.toml` says they are to be read."""
        config = self.config()
        how = [config.longest_side, config.frames, config.units, config.up, config.keypoint_layout]
        return [self.videos, self.offsets(), *map(self.hash_of, ("keypoints", "cameras", "masks")), how]

    def of_track(self) -> Any:
        """List what the motion is made of."""
        options, selected = self.options, self.config().selected_frames
        told = [options.quality, options.frames, options.seed, options.detections]
        return [self.seen(), self.hash_of("actor"), selected, told]
