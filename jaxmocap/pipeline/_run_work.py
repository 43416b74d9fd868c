"""How a run makes a motion of a capture with keypoints and cameras; each stage returns what it wrote, as JSON knows
it."""

import math
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax

from jaxmocap._cache import code_hash, machine
from jaxmocap._files import atomic_path, free_name
from jaxmocap._results import InputError
from jaxmocap._runtime import versions
from jaxmocap.calibration import scale_in_place
from jaxmocap.character import BodyShape, Character, scaled, stature
from jaxmocap.motion import Motion
from jaxmocap.rigging import brings_skin, open_actor
from jaxmocap.viewers import REPORT_PAGE, report_page

from ._defaults import with_selected_frames
from ._made_to_measure import MadeBody, character_of
from ._run_folder import finished, refuse_foreign
from ._run_footage import FootageWork
from ._run_options import span_within
from ._scan import scan
from ._track_capture import track_capture

_SAME_HEIGHT = 0.005  # of an actor's own and the one that is given

TRACKED_LIKE = "tracked like"
"""What the record calls that on which the time to track rests."""

RESULT = "result"
"""Folder of a run in which its first result lies."""


class RunWork(FootageWork):
    """A run at work."""

    def body(self) -> Any:
        """Take the actor, make one of a walk around the person, or make a body to the person's measure."""
        options, colours = self.options, None
        as_it_is = False
        if options.actor is not None:
            character, as_it_is = self._actor(options.actor)
        elif options.scan is not None:
            height = options.height if options.body_first else self._measured_height()
            told = {"height": height, "seed": options.seed, "say": self.say, "progress": self.progress}
            scanned = scan(options.scan, weights=options.weights, **told)
            character, colours = scanned.rigged.character, scanned.colours
        else:
            made = self._made_to_measure()
            character = made.character
            if made.camera_scale != 1:
                self._scale_cameras(made.camera_scale)
        file = free_name(self.folder, "actor", ".glb")
        with atomic_path(file) as partial:
            if as_it_is and options.actor is not None:
                shutil.copyfile(options.actor, partial)
            else:
                character.save_glb(partial, colours)
        self._announce("body", "actor", file.name)
        self._set(actor=file.name)
        return file.name

    def _made_to_measure(self) -> MadeBody:
        """Make the built-in body to the person's measure: as tall as was said, or as the cameras' scale has it."""
        return character_of(
            replace(self._open(), actor=None),
            height=self.options.height,
            scale_cameras=self.scale_from_height(),
            within=self.options.frames,
            key=jax.random.key(self.options.seed),
            say=self.say,
            progress=self.progress,
        )

    def _measured_height(self) -> float:
        """Measure in the videos how tall the person is, whose cameras' distance tells the scale."""
        height = round(float(stature(self._made_to_measure().character)), 4)
        self.say(f"The scan is made {height:.2f} m tall, as the person is by the distance between the cameras.")
        return height

    def _actor(self, file: Path) -> tuple[Character, bool]:
        """Open the actor, as tall as the person; tell whether that is what is in its file, a skinned GLB."""
        height = self.options.height
        character = open_actor(file, self.say, height)
        tall = float(stature(character))
        if height is None or abs(height / tall - 1) < _SAME_HEIGHT:
            return character, file.suffix.lower() == ".glb" and brings_skin(file)
        self.say(f"{file} is {tall:.2f} m tall, and was scaled to the {height:.2f} m that were given.")
        return scaled(character, BodyShape.of(math.log(height / tall))), False

    def _scale_cameras(self, factor: float) -> None:
        """Make the cameras' world as large as the person's outlines and height say."""
        folder = scale_in_place(self.folder, factor, self._naming_cameras, self.progress)
        self.record.set("calibrate", self.of_calibrate(), folder.name)
        self.say(f"The outlines and the height tell the scale: the cameras' positions were multiplied by {factor:.3f}.")

    def select(self) -> Any:
        """Choose the selected frames."""
        capture = self._open()
        _, chosen = with_selected_frames(replace(capture, selected_frames=None), within=self.options.frames)
        self._announce("selected frames", "selected_frames", chosen["frames"])
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
            say=self.say,
            resume=True,
        )
        self.record.set(TRACKED_LIKE, self.tracked_like(), None)
        return folder.name

    def _result_folder(self) -> Path:
        """Choose the folder of an unfinished run of the same inputs, or a new one: results are never overwritten."""
        inputs = [self.of_track(), code_hash(), versions(), machine()]  # as the checkpoint knows them
        ongoing = self.record.made("tracking")
        if ongoing is not None and self.record.done("tracking", inputs) and _can_be_gone_on_with(self.out / ongoing):
            return self.out / ongoing
        folder = free_name(self.out, RESULT)
        self.record.set("tracking", inputs, folder.name)
        return folder

    def tracked_like(self) -> tuple[int, str]:
        """List on what the time to track rests: how many frames, of the first video at most, and the preset."""
        first, stop = self.options.frames
        count = self.indices[0].num_frames
        return max(min(count if stop is None else stop, count) - first, 1), self.options.quality

    def result(self) -> tuple[Path, Motion, Path]:
        """Return the folder of the result, the motion in it and its page, which is written anew if it was deleted."""
        folder = self.out / str(self.record.made("track"))
        page = folder / REPORT_PAGE
        if not page.is_file():
            page = report_page(folder, capture=self._open(), say=self.say)
        return folder, Motion.load(folder), page


def _can_be_gone_on_with(folder: Path) -> bool:
    """Tell whether a result can be written into a folder, or is there already; not where a part of it was deleted."""
    try:
        refuse_foreign(folder)
    except InputError:
        return finished(folder)
    return True
