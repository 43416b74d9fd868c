"""How the stages of a run are done; each returns what it wrote, as JSON knows it."""

import os
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jaxmocap._files import atomic_folder, atomic_path, free_name, write_text
from jaxmocap._results import InputError
from jaxmocap.calibration import scale_cameras, usual_focal
from jaxmocap.camera import Cameras, write_cameras
from jaxmocap.capture import Capture, config_path, new_capture_text, video_names, with_lines, with_offsets
from jaxmocap.motion import Motion
from jaxmocap.rigging import open_actor

from ._calibrate import calibrate
from ._defaults import with_selected_frames
from ._detect import detect
from ._keypoint_store import DETECTION_REPORT
from ._made_to_measure import character_of
from ._run_inputs import RunInputs
from ._run_options import span_within
from ._scan import scan
from ._synchronise import sync
from ._synchronise_by_person import sync_by_person
from ._track_capture import track_capture

RESULT = "result"
"""Folder of a run in which its first result lies."""

_AS_FOUND = "keypoints as found"
"""What the record calls the keypoints that nobody has corrected."""


class NotDetected(InputError):
    """Keypoints that another stage needed could not be had."""


class RunWork(RunInputs):
    """A run at work."""

    def _open(self, with_cameras: bool = True) -> Capture:
        return Capture.open(self.folder, with_cameras=with_cameras)

    def _set(self, **lines: Any) -> None:
        file = config_path(self.folder)
        write_text(file, with_lines(file.read_bytes().decode("utf-8"), lines, file))

    def _forget_selected_frames(self) -> None:
        """Take out those that an earlier run chose: with other offsets the videos may no longer share them."""
        chosen = self.record.made("selected frames")
        if chosen is not None and chosen == self.config().selected_frames:
            self._set(selected_frames=None)

    def make_capture(self) -> Any:
        """Make the capture folder, with links to the videos."""
        if self.record.begun("capture") and self.folder.exists():
            raise InputError(
                f"{self.out} holds a run of other videos; choose another folder with --out, or delete that one"
            )
        paths = [index.path for index in self.indices]
        copies = video_names(paths, self.names)
        with atomic_folder(self.folder) as partial:
            for name, video in copies.items():
                _link_or_copy(video, partial / name)
            text = new_capture_text(self.out, self.indices[0].interval, dict(zip(self.names, copies, strict=True)))
            write_text(partial / "capture.toml", text)
        return list(copies)

    def synchronise(self) -> Any:
        """Take the offsets that are given, or find when each video began."""
        self._forget_selected_frames()
        if self.options.offset:
            file = config_path(self.folder)
            offsets = [self.options.offset.get(name, 0.0) for name in self.names]
            write_text(file, with_offsets(file.read_bytes().decode("utf-8"), offsets, file))
            return self.offsets()
        try:
            found = sync(self.folder, progress=self.progress)
        except InputError as error:
            return self._synchronise_by_person(error)
        record = found.record()
        offsets = ", ".join(f"{name} {one['offset_frames']:+.2f}" for name, one in record["cameras"].items())
        self.say(f"Offsets in frames: {offsets}; by {', '.join(sorted({pair['used'] for pair in record['pairs']}))}.")
        for note in found.notes:
            self.say(f"{note}.")
        return self.offsets()

    def _synchronise_by_person(self, error: InputError) -> Any:
        """Ask the keypoints, which are looked for now; the refusal stands where they are not sure either."""
        self.say("Neither flash, sound nor motion of the pictures tells when the videos began: keypoints are asked.")
        if self.config().keypoints is None:
            try:
                made = self.detect()
            except InputError as refused:
                raise NotDetected(str(refused)) from refused
            self.record.set("detect", None, made)  # other frames are shared once the offsets are known
        found = sync_by_person(self.folder)
        if found is None:
            raise error
        moved = ", ".join(f"{one.seconds / self.indices[0].interval:+.2f}" for one in found)
        alike = min(one.likeness for one in found)
        self.say(f"Offsets in frames: +0.00, {moved}; by the person's motion (likeness {alike:.2f}).")
        return self.offsets()

    def detect(self) -> Any:
        """Find the person's keypoints, or take those that are given."""
        self._forget_selected_frames()
        options = self.options
        if options.keypoints is not None:
            folder = free_name(self.folder, "keypoints")
            with atomic_folder(folder) as partial:
                shutil.copytree(options.keypoints, partial, dirs_exist_ok=True)
            self._set(keypoints=folder.name)
            return folder.name
        return self._find_person()

    def _find_person(self) -> str:
        """Look for the person where nobody has yet, and hold views against each other where there are cameras."""
        options, named = self.options, self.config().keypoints
        found = detect(
            self.folder,
            weights=options.weights,
            person=options.person,
            replace=named is not None and not (self.folder / DETECTION_REPORT).exists(),
            say=self.say,
            progress=self.progress,
        )
        self.record.set(_AS_FOUND, self.hash_of("keypoints"), None)
        assert found.folder is not None
        return found.folder.name

    def calibrate(self) -> Any:
        """Find the cameras."""
        self._forget_selected_frames()
        options, synchronised = self.options, self.offsets()
        calibrate(
            self.folder,
            replace=True,
            height=options.height,
            camera_distance=options.camera_distance,
            focal=dict(options.focal),
            static=options.static or None,
            frames=span_within(options.frames, self._open(with_cameras=False).num_frames),
            keep_offsets=bool(options.offset) or self.offsets() != self.record.made("synchronise"),
            seed=options.seed,
            say=self.say,
            progress=self.progress,
        )
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
        write_cameras(_level_camera(name, size, focal, capture.num_frames), folder, "colmap", capture.video_frames)
        self._set(cameras=folder.name)
        return folder.name

    def body(self) -> Any:
        """Take the actor, make one of a walk around the person, or make a body to the person's measure."""
        options, colours = self.options, None
        if options.actor is not None:
            character = open_actor(options.actor, self.say)
        elif options.scan is not None:
            told = {"height": options.height, "seed": options.seed, "say": self.say, "progress": self.progress}
            scanned = scan(options.scan, weights=options.weights, **told)
            character, colours = scanned.rigged.character, scanned.colours
        else:
            key = jax.random.key(options.seed)
            capture = replace(self._open(), actor=None)
            made = character_of(
                capture,
                height=options.height,
                scale_cameras=self.scale_from_height(),
                key=key,
                say=self.say,
                progress=self.progress,
            )
            character = made.character
            if made.camera_scale != 1:
                self._scale_cameras(made.camera_scale)
        file = free_name(self.folder, "actor", ".glb")
        with atomic_path(file) as partial:
            if options.actor is not None and options.actor.suffix.lower() == ".glb":
                shutil.copyfile(options.actor, partial)
            else:
                character.save_glb(partial, colours)
        self._set(actor=file.name)
        return file.name

    def _scale_cameras(self, factor: float) -> None:
        """Make the cameras' world as large as the person's outlines and height say."""
        folder = scale_cameras(self.folder, factor, progress=self.progress)
        self.record.set("calibrate", self.of_calibrate(), folder.name)
        self.say(f"The outlines and the height tell the scale: the cameras' positions were multiplied by {factor:.3f}.")

    def select(self) -> Any:
        """Choose the selected frames."""
        capture = self._open()
        _, chosen = with_selected_frames(replace(capture, selected_frames=None), within=self.options.frames)
        self._set(selected_frames=chosen["frames"])
        self.say(f"Selected frames: {', '.join(map(str, chosen['frames']))}; {chosen['reason']}.")
        return chosen["frames"]

    def track(self) -> Any:
        """Track the person, and write the result."""
        capture, options = self._open(), self.options
        folder = self._result_folder()
        track_capture(
            self.folder,
            folder,
            quality=options.quality,
            seed=options.seed,
            frames=span_within(options.frames, capture.num_frames),
            progress=self.progress,
            detections=capture.keypoints_folder if options.detections else None,
            say=lambda sentence: self.say(sentence.replace(" with --resume", "")),  # a run goes on by itself
            resume=True,
        )
        return folder.name

    def _result_folder(self) -> Path:
        """Choose the folder of an unfinished run of the same inputs, or a new one: results are never overwritten."""
        ongoing = self.record.made("tracking")
        if ongoing is not None and self.record.done("tracking", self.of_track()):
            return self.out / ongoing
        folder = free_name(self.out, RESULT)
        self.record.set("tracking", self.of_track(), folder.name)
        return folder

    def result(self) -> tuple[Path, Motion]:
        """Return the folder of the result and the motion in it."""
        folder = self.out / str(self.record.made("track"))
        return folder, Motion.load(folder)


def _level_camera(name: str, size: tuple[int, int], focal: float, num_frames: int) -> Cameras:
    """Place a camera at the world's origin that looks ahead, y up."""
    intrinsics = np.array([[focal, 0, size[0] / 2], [0, focal, size[1] / 2], [0, 0, 1]], np.float32)
    pose = np.diag([1.0, -1.0, -1.0, 1.0]).astype(np.float32)
    poses = np.broadcast_to(pose, (1, num_frames, 4, 4))
    asarray = jax.numpy.asarray
    return Cameras((name,), (size,), asarray(intrinsics[None]), asarray(np.zeros((1, 5), np.float32)), asarray(poses))


def _link_or_copy(video: Path, place: Path) -> None:
    """Link a video, which costs no room; where the file system has no links, copy it."""
    try:
        os.link(video.resolve(), place)
    except OSError:
        shutil.copyfile(video, place)
