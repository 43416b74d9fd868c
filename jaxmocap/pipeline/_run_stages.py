"""The stages of a run: what each is made of, what it writes into the capture folder, and how it is done."""

import os
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxmocap._files import atomic_folder, atomic_path, free_name, write_text
from jaxmocap._results import InputError
from jaxmocap.camera import Cameras, write_cameras
from jaxmocap.capture import (
    Capture,
    VideoIndex,
    camera_names,
    config_path,
    new_capture_text,
    path_hash,
    read_config,
    video_names,
    with_lines,
)
from jaxmocap.motion import Motion
from jaxmocap.rigging import open_actor

from ._calibrate import calibrate
from ._defaults import with_selected_frames
from ._detect import DETECTION_REPORT, detect
from ._made_to_measure import character_of
from ._run_options import RunOptions
from ._run_record import RunRecord
from ._synchronise import sync
from ._synchronise_by_person import sync_by_person
from ._track_capture import track_capture

CAPTURE, RESULT = "capture", "result"
"""Folders of a run."""

_AS_FOUND = "keypoints as found"
"""What the record calls the keypoints that nobody has corrected."""

Say = Callable[[str], None]
Report = Callable[[str, int, int], None]


class Stage(NamedTuple):
    """One stage of a run.

    Attributes:
        name: as messages call it.
        what: it does, in a few words.
        line: of `capture.toml` that it sets; None where it sets none.
        inputs: what it is made of now; may only be asked once the stages before are done.
        do: does it, and returns what it wrote, as JSON knows it.
        advice: what to do where it fails.
    """

    name: str
    what: str
    line: str | None
    inputs: Callable[[], Any]
    do: Callable[[], Any]
    advice: str


@dataclass(frozen=True)
class RunWork:
    """A run at work: its videos and options, its folder, and whom to tell."""

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

    @cached_property
    def _videos(self) -> list[str]:
        return [path_hash(index.path) for index in self.indices]

    def stages(self) -> list[Stage]:
        """The stages in their order."""
        found = [
            Stage(
                "capture",
                "make a capture folder of the videos",
                None,
                lambda: self._videos,
                self._make_capture,
                "choose another folder with --out",
            )
        ]
        if self.several:
            found.append(
                Stage(
                    "synchronise",
                    "find when each video began",
                    "offset",
                    lambda: self._videos,
                    self._synchronise,
                    f"write offset = SECONDS below each [[camera]] of {self.folder}/capture.toml",
                )
            )
        detect = Stage(
            "detect",
            "take the keypoints given" if self.options.keypoints else "find the person's keypoints",
            "keypoints",
            self._detect_inputs,
            self._detect,
            "say where the person is in the first picture with --person CAMERA=X,Y, or give another detector's files "
            "with --keypoints DIR",
        )
        calibrate = Stage(
            "calibrate",
            "find the cameras" if self.several else "assume a camera that stands still",
            "cameras",
            self._calibrate_inputs,
            self._calibrate if self.several else self._one_camera,
            "leave out a video that shows another place, say --static where all phones stood still, or give cameras of "
            f"your own (jaxmocap cameras {self.folder} --from FILE)"
            if self.several
            else f"give a camera of your own (jaxmocap cameras {self.folder} --from FILE)",
        )
        body = Stage(
            "body",
            "take the actor" if self.options.actor else "make a body to the person's measure",
            "actor",
            self._body_inputs,
            self._body,
            "give a scan or a character of the person with --actor FILE",
        )
        middle = [body, detect, calibrate] if self.options.actor else [detect, calibrate, body]  # bones tell the scale
        found += [
            *middle,
            Stage(
                "selected frames",
                "choose the frames that colours and poses begin with",
                "selected_frames",
                self._seen,
                self._select,
                f"write selected_frames = [N, ...] into {self.folder}/capture.toml",
            ),
            Stage(
                "track",
                "track the person and write the report",
                None,
                self._track_inputs,
                self._track,
                f"look at the poses it begins with: jaxmocap register {self.folder} --out registered",
            ),
        ]
        return found

    def written(self, stage: Stage) -> Any:
        """What `capture.toml` says in the stage's line now; None without it."""
        file = self.folder / "capture.toml"
        if stage.line is None or not file.is_file():
            return None
        config, findings = read_config(file)
        if config is None:
            raise InputError(next(finding.message for finding in findings if finding.severity == "error"))
        if stage.line == "offset":
            given = any("offset" in camera.model_fields_set for camera in config.camera)
            return [camera.offset for camera in config.camera] if given else None
        return getattr(config, stage.line)

    # What stages are made of ------------------------------------------------------------------------------------

    def _config(self) -> Any:
        config, findings = read_config(config_path(self.folder))
        if config is None:
            raise InputError(next(finding.message for finding in findings if finding.severity == "error"))
        return config

    def _hash(self, key: str) -> str | None:
        """Of what a line of `capture.toml` names."""
        named = getattr(self._config(), key)
        path = None if named is None else self.folder / named
        return None if path is None or not path.exists() else path_hash(path)

    def _offsets(self) -> list[float]:
        return [camera.offset for camera in self._config().camera]

    def _detect_inputs(self) -> Any:
        options = self.options
        given = None if options.keypoints is None else path_hash(options.keypoints)
        weights = None if options.weights is None else str(options.weights)
        return [self._videos, given, weights, sorted(options.person.items()), self._offsets()]

    def _calibrate_inputs(self) -> Any:
        options = self.options
        size = path_hash(options.actor) if options.actor and not (options.height or options.camera_distance) else None
        told = [options.height, options.camera_distance, sorted(options.focal.items()), options.static, options.seed]
        return [self._videos, self._offsets(), self._hash("keypoints"), size, told]

    def _body_inputs(self) -> Any:
        if self.options.actor is not None:
            return path_hash(self.options.actor)
        return [self._seen(), self.options.height, self.options.seed]

    def _seen(self) -> Any:
        return [self._videos, self._offsets(), self._hash("keypoints"), self._hash("cameras"), self._hash("masks")]

    def _track_inputs(self) -> Any:
        options, selected = self.options, self._config().selected_frames
        told = [options.quality, options.frames, options.seed, options.detections]
        return [self._seen(), self._hash("actor"), selected, told]

    # How they are done ------------------------------------------------------------------------------------------

    def _open(self, with_cameras: bool = True) -> Capture:
        return Capture.open(self.folder, with_cameras=with_cameras)

    def _span(self, capture: Capture) -> tuple[int, int] | None:
        """The frames to track, within those the videos share."""
        start, stop = self.options.frames
        if start is None and stop is None:
            return None
        first, behind = start or 0, capture.num_frames if stop is None else stop
        if not 0 <= first < behind <= capture.num_frames:
            raise InputError(
                f"frames {first}:{behind} were asked for, but the videos share {capture.num_frames} frames, 0 to "
                f"{capture.num_frames - 1}"
            )
        return first, behind

    def _set(self, **lines: Any) -> None:
        file = config_path(self.folder)
        write_text(file, with_lines(file.read_bytes().decode("utf-8"), lines, file))

    def _make_capture(self) -> Any:
        if self.record.begun("capture") and self.folder.exists():
            raise InputError(
                f"{self.out} holds a run of other videos; choose another folder with --out, or delete that one"
            )
        paths = [index.path for index in self.indices]
        names = camera_names(paths)
        copies = video_names(paths, names)
        with atomic_folder(self.folder) as partial:
            for name, video in copies.items():
                _link_or_copy(video, partial / name)
            text = new_capture_text(self.out, self.indices[0].interval, dict(zip(names, copies, strict=True)))
            write_text(partial / "capture.toml", text)
        return list(copies)

    def _synchronise(self) -> Any:
        try:
            found = sync(self.folder, progress=self.progress)
        except InputError as error:
            return self._synchronise_by_person(error)
        record = found.record()
        offsets = ", ".join(f"{name} {one['offset_frames']:+.2f}" for name, one in record["cameras"].items())
        self.say(f"Offsets in frames: {offsets}; by {', '.join(sorted({pair['used'] for pair in record['pairs']}))}.")
        for note in found.notes:
            self.say(f"{note}.")
        return self._offsets()

    def _synchronise_by_person(self, error: InputError) -> Any:
        """Ask the keypoints, which are looked for now; the refusal stands where they are not sure either."""
        self.say("Neither flash, sound nor motion of the pictures tells when the videos began: keypoints are asked.")
        if self._config().keypoints is None:
            made = self._detect()
            self.record.set("detect", None, made)  # other frames are shared once the offsets are known
        found = sync_by_person(self.folder)
        if found is None:
            raise error
        moved = ", ".join(f"{one.seconds / self.indices[0].interval:+.2f}" for one in found)
        alike = min(one.likeness for one in found)
        self.say(f"Offsets in frames: +0.00, {moved}; by the person's motion (likeness {alike:.2f}).")
        return self._offsets()

    def _detect(self) -> Any:
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
        options, named = self.options, self._config().keypoints
        found = detect(
            self.folder,
            weights=options.weights,
            person=options.person,
            replace=named is not None and not (self.folder / DETECTION_REPORT).exists(),
            say=self.say,
            progress=self.progress,
        )
        self.record.set(_AS_FOUND, self._hash("keypoints"), None)
        assert found.folder is not None
        return found.folder.name

    def _calibrate(self) -> Any:
        options = self.options
        calibrate(
            self.folder,
            replace=True,
            height=options.height,
            camera_distance=options.camera_distance,
            focal=dict(options.focal),
            static=options.static,
            seed=options.seed,
            say=self.say,
            progress=self.progress,
        )
        if self.options.keypoints is None and self.record.done(_AS_FOUND, self._hash("keypoints")):
            self._find_person()  # among views, now that there are cameras
        return self._config().cameras

    def _one_camera(self) -> Any:
        """A camera that stands still and level, for one video tells neither its way nor the ground."""
        capture = self._open(with_cameras=False).as_recorded()
        name, size = capture.camera_names[0], capture.recorded_sizes[0]
        focal = self.options.focal.get(name, FOCAL * max(size))
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

    def _body(self) -> Any:
        options = self.options
        if options.actor is not None:
            character = open_actor(options.actor, self.say)
        else:
            key = jax.random.key(options.seed)
            capture = self._open()._with(actor=None)
            made = character_of(capture, height=options.height, key=key, say=self.say, progress=self.progress)
            character = made.character
        file = free_name(self.folder, "actor", ".glb")
        with atomic_path(file) as partial:
            if options.actor is not None and options.actor.suffix.lower() == ".glb":
                shutil.copyfile(options.actor, partial)
            else:
                character.save_glb(partial)
        self._set(actor=file.name)
        return file.name

    def _select(self) -> Any:
        _, chosen = with_selected_frames(self._open()._with(selected_frames=None))
        self._set(selected_frames=chosen["frames"])
        self.say(f"Selected frames: {', '.join(map(str, chosen['frames']))}; {chosen['reason']}.")
        return chosen["frames"]

    def _track(self) -> Any:
        capture, options = self._open(), self.options
        folder = self._result_folder()
        track_capture(
            self.folder,
            folder,
            quality=options.quality,
            seed=options.seed,
            frames=self._span(capture),
            progress=self.progress,
            detections=capture.keypoints_folder if options.detections else None,
            say=lambda sentence: self.say(sentence.replace(" with --resume", "")),  # a run goes on by itself
            resume=True,
        )
        return folder.name

    def _result_folder(self) -> Path:
        """The folder of an unfinished run of the same inputs, or a new one: results are never overwritten."""
        ongoing = self.record.made("tracking")
        if ongoing is not None and self.record.done("tracking", self._track_inputs()):
            return self.out / ongoing
        folder = free_name(self.out, RESULT)
        self.record.set("tracking", self._track_inputs(), folder.name)
        return folder

    def result(self) -> tuple[Path, Motion]:
        """The folder of the result and the motion in it."""
        folder = self.out / str(self.record.made("track"))
        return folder, Motion.load(folder)


FOCAL = 0.8
"""Focal length of a phone's main camera as a share of the longer side of its pictures."""


def _level_camera(name: str, size: tuple[int, int], focal: float, num_frames: int) -> Cameras:
    """A camera at the world's origin that looks ahead, y up."""
    intrinsics = np.array([[focal, 0, size[0] / 2], [0, focal, size[1] / 2], [0, 0, 1]], np.float32)
    pose = np.diag([1.0, -1.0, -1.0, 1.0]).astype(np.float32)
    poses = np.broadcast_to(pose, (1, num_frames, 4, 4))
    asarray = jax.numpy.asarray
    return Cameras((name,), (size,), asarray(intrinsics[None]), asarray(np.zeros((1, 5), np.float32)), asarray(poses))


def _link_or_copy(video: Path, place: Path) -> None:
    """A link costs no room; where the file system has none, the video is copied."""
    try:
        os.link(video.resolve(), place)
    except OSError:
        shutil.copyfile(video, place)
