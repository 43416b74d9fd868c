"""How a run makes of videos a capture with the person's keypoints and cameras; each stage returns what it wrote, as
JSON knows it."""

from typing import Any

from jaxmocap._files import atomic_folder, free_name, write_text
from jaxmocap._results import InputError
from jaxmocap.calibration import level_camera, usual_focal
from jaxmocap.camera import write_cameras
from jaxmocap.capture import (
    Capture,
    config_path,
    new_capture_text,
    path_hash,
    shared_frames,
    video_names,
    with_lines,
    with_offsets,
)

from ._calibrate import calibrate_folder
from ._detect import detect
from ._run_files import copy_keypoints, link_or_copy
from ._run_inputs import RunInputs
from ._run_options import span_within
from ._synchronise import sync
from ._synchronise_by_person import sync_by_person
from ._view_agreement import refuse_views_of_different_people

_AS_FOUND = "keypoints as found"
_ASKED = "keypoints that were asked for the time"
"""What the record calls the keypoints that nobody has corrected."""


class NotDetected(InputError):
    """Keypoints that another stage needed could not be had."""


class FootageWork(RunInputs):
    """A run at work on what was filmed."""

    def _open(self, with_cameras: bool = True) -> Capture:
        return Capture.open(self.folder, with_cameras=with_cameras)

    def _set(self, **lines: Any) -> None:
        file = config_path(self.folder)
        write_text(file, with_lines(file.read_bytes().decode("utf-8"), lines, file))

    def _forget(self, *stages: str) -> None:
        """Take out of `capture.toml` what these stages of an earlier run wrote, and selected frames in any case.

        They must not count in what is done anew: selected frames that the videos no longer share, the bones of a body
        that was made of other keypoints, cameras that keypoints are held against. What was set by hand stays.
        """
        found = {
            line: None
            for stage, (line, _) in self._own_lines(*stages, "selected frames").items()
            if not (stage == "body" and self.options.body_first)  # made before, of the person's own surface
        }
        if found:
            self._set(**found)

    def forget_deleted(self) -> None:
        """Take out of `capture.toml` what an earlier run made and somebody has deleted since: it is made again."""
        if not (self.folder / "capture.toml").is_file():
            return
        own = self._own_lines("detect", "calibrate", "body")
        deleted = {line: None for line, name in own.values() if not (self.folder / name).exists()}
        if deleted:
            self._set(**deleted)

    def _own_lines(self, *stages: str) -> dict[str, tuple[str, Any]]:
        """Find what `capture.toml` says that these stages wrote: by stage, the line and what it says."""
        config = self.config()
        lines = {"detect": "keypoints", "calibrate": "cameras", "body": "actor", "selected frames": "selected_frames"}
        found = {stage: (lines[stage], getattr(config, lines[stage])) for stage in stages}
        return {
            stage: (line, value)
            for stage, (line, value) in found.items()
            if value is not None and value == self.record.made(stage)
        }

    def _wrote(self, stage: str, made: Any) -> None:
        """Note what a stage wrote before it ends: if it is cut off, that is not taken for a change by hand."""
        if self.record.made(stage) != made:
            self.record.set(stage, None, made)

    def _announce(self, stage: str, line: str, made: Any) -> None:
        """Note what a stage is about to write into a line of `capture.toml`, which is empty until then.

        Whenever the run is cut off, nothing seems to be set by hand.
        """
        self._set(**{line: None})
        self.record.set(stage, None, made)

    def _naming_cameras(self, name: str) -> None:
        self._announce("calibrate", "cameras", name)

    def make_capture(self) -> Any:
        """Make the capture folder, with links to the videos."""
        if self.record.begun("capture") and self.folder.exists():
            kept = [self.folder / camera.video for camera in self.config().camera]
            if sorted(path_hash(video) for video in kept if video.is_file()) == sorted(self.videos):
                raise InputError(
                    f"{self.out} holds a run of the same videos in another order; give them in the order of the "
                    f"cameras of {self.folder}/capture.toml: {', '.join(self.names)}"
                )
            raise InputError(
                f"{self.out} holds a run of other videos; choose another folder with --out, or delete that one"
            )
        paths = [index.path for index in self.indices]
        copies = video_names(paths, self.names)
        made, videos = list(copies), self.videos
        with atomic_folder(self.folder) as partial:
            for name, video in copies.items():
                link_or_copy(video, partial / name)
            text = new_capture_text(self.out, self.indices[0].interval, dict(zip(self.names, copies, strict=True)))
            write_text(partial / "capture.toml", text)
            self.record.set("capture", videos, made)  # whenever it is cut off, the folder is known for this run's
        return made

    def synchronise(self) -> Any:
        """Take the offsets that are given, or find when each video began."""
        self._forget()
        if self.options.offset:
            file = config_path(self.folder)
            offsets = [self.options.offset.get(name, 0.0) for name in self.names]
            shared_frames(self.indices, offsets)  # raises where they share no moment
            write_text(file, with_offsets(file.read_bytes().decode("utf-8"), offsets, file))
            return self.offsets()
        try:
            found = sync(self.folder, progress=self.progress)
        except InputError as error:
            return self._synchronise_by_person(error)
        record = found.record()
        offsets = ", ".join(f"{name} {one['offset_frames']:+.2f}" for name, one in record["cameras"].items())
        used = sorted({pair["used"] for pair in record["pairs"] if pair["used"] is not None})
        self.say(f"Offsets in frames: {offsets}; by {', '.join(used)}.")
        for note in found.notes:
            self.say(f"{note}.")
        return self.offsets()

    def refuse_frames_not_shared(self) -> None:
        """Raise `InputError` for frames to track that the videos, as they are synchronised, do not share."""
        span_within(self.options.frames, shared_frames(self.indices, self.offsets()).shape[1])

    def _synchronise_by_person(self, error: InputError) -> Any:
        """Ask the keypoints, which are looked for now; the refusal stands where they are not sure either."""
        self.say("Neither flash, sound nor motion of the pictures tells when the videos began: keypoints are asked.")
        named, asked = self.config().keypoints, self.of_person()
        if named is None or (named == self.record.made("detect") and not self.record.done(_ASKED, asked)):
            try:
                made = self.detect()
            except InputError as refused:
                raise NotDetected(str(refused)) from refused
            self.record.set("detect", None, made)  # other frames are shared once the offsets are known
            self.record.set(_ASKED, asked, None)
        found = sync_by_person(self.folder)
        if found is None:
            raise error
        moved = ", ".join(f"{one.seconds / self.indices[0].interval:+.2f}" for one in found)
        alike = min(one.likeness for one in found)
        self.say(f"Offsets in frames: +0.00, {moved}; by the person's motion (likeness {alike:.2f}).")
        return self.offsets()

    def detect(self) -> Any:
        """Find the person's keypoints, or take those that are given."""
        self._forget("detect", "calibrate", "body")
        options = self.options
        if options.keypoints is not None:
            folder = free_name(self.folder, "keypoints")
            with atomic_folder(folder) as partial:
                copy_keypoints(options.keypoints, partial, self.indices, self.names)
            self._announce("detect", "keypoints", folder.name)
            self._set(keypoints=folder.name)
            return folder.name
        return self._find_person()

    def _find_person(self) -> str:
        """Look for the person where nobody has yet, and hold views against each other where there are cameras."""
        found = detect(
            self.folder,
            weights=self.options.weights,
            person=self.options.person,
            say=self.say,
            progress=self.progress,
        )
        assert found.folder is not None
        self._wrote("detect", found.folder.name)
        self.record.set(_AS_FOUND, self.hash_of("keypoints"), None)
        return found.folder.name

    def calibrate(self) -> Any:
        """Find the cameras."""
        self._forget("body")
        options, synchronised = self.options, self.offsets()
        found = calibrate_folder(
            self.folder,
            self.say,
            replace=True,
            naming=self._naming_cameras,
            height=options.height,
            camera_distance=options.camera_distance,
            focal=dict(options.focal),
            static=options.static or None,
            frames=span_within(options.frames, self._open(with_cameras=False).num_frames) or (0, None),
            keep_offsets=bool(options.offset) or self.offsets() != self.record.made("synchronise"),
            seed=options.seed,
            progress=self.progress,
        )
        for warning in found.record["warnings"]:
            self.say(f"Warning: {warning}.")
        refuse_views_of_different_people(self._open(), options.frames)
        if self.offsets() != synchronised:
            self.record.set("synchronise", self.of_synchronise(), self.offsets())
            if self.record.begun("detect"):
                self.record.set("detect", self.of_detect(), self.record.made("detect"))
        if self.options.keypoints is None and self.record.done(_AS_FOUND, self.hash_of("keypoints")):
            self._find_person()  # among views, now that there are cameras
        return self.config().cameras

    def one_camera(self) -> Any:
        """Take a camera that stands still and level, for one video tells neither its way nor the ground."""
        capture = self._open(with_cameras=False).as_recorded()
        name, size = capture.camera_names[0], capture.recorded_sizes[0]
        focal = self.options.focal.get(name) or usual_focal(capture.indices[0].path, size)
        if name not in self.options.focal:
            self.say(
                f"One video does not tell the lens: a focal length of {focal:.0f} pixels is assumed, a phone's; say a "
                f"better one with --focal {name}=PIXELS."
            )
        self.say(
            "One view: the camera is taken to stand still and level, distances from it rest on the person's height, "
            "and which way limbs point in depth is a guess."
        )
        folder = free_name(self.folder, "cameras")
        write_cameras(level_camera(name, size, focal, capture.num_frames), folder, "colmap", capture.video_frames)
        self._naming_cameras(folder.name)
        self._set(cameras=folder.name)
        return folder.name
