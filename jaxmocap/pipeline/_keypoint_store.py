"""The keypoint files that `detect` keeps in a capture, and its record of how they were made."""

import json
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import Bool

from jaxmocap._files import free_name, write_bytes, write_json, write_text
from jaxmocap._results import InputError
from jaxmocap.capture import SILHOUETTES, Capture, mask_file, with_keypoints_line
from jaxmocap.detection import FollowedPerson, ModelName, SeenSoFar, read_person, read_seen, write_person, write_seen

DETECTION_REPORT = "detection.json"
"""Beside `capture.toml`: which model found whom, where."""


@dataclass
class KeypointStore:
    """The keypoint files in a capture, and the record beside them, written after each camera."""

    file: Path
    folder: Path
    anew: bool
    record: dict[str, Any] = field(default_factory=dict)

    @staticmethod
    def open(file: Path, replace: bool) -> "KeypointStore":
        """Open the store of a capture.

        Raises `InputError` if `capture.toml` names other keypoints, unless `replace`, or cannot be written.
        """
        record = _read_record(file.parent / DETECTION_REPORT)
        named = Capture.open(file, with_cameras=False).keypoints_folder
        ours = file.parent / record["folder"] if record else None
        if named is not None and named != ours and not replace:
            raise InputError(
                f"{file} names keypoints already ('{named.relative_to(file.parent)}'); remove the line, or use "
                "--replace, which leaves the old ones where they are"
            )
        if not os.access(file.parent, os.W_OK):
            raise InputError(f"{file.parent} cannot be written to; copy the capture to a place of your own")
        folder = free_name(file.parent, "keypoints") if ours is None else ours
        return KeypointStore(file, folder, replace, record or {"folder": folder.name, "cameras": {}})

    def has(self, name: str, inputs: dict[str, Any], model: ModelName | None, frames: np.ndarray) -> bool:
        """Tell whether the person has been looked for in all these frames."""
        if (known := self._known(name, inputs)) is None or model not in (None, known["model"]["name"]):
            return False
        return set(frames) <= set(read_person(self._path(name)).frames)

    def add(self, name: str, inputs: dict[str, Any], model: dict[str, Any], found: FollowedPerson) -> None:
        """Write what was found; frames that were looked at before in the same way stay."""
        known = self._known(name, inputs)
        if known is not None and known["model"] == model:
            found = read_person(self._path(name)).joined(found)
        self.folder.mkdir(exist_ok=True)
        write_person(self._path(name), found)
        self._drop_silhouettes(name, found)
        self.record["cameras"][name] = {**inputs, "model": model, "notes": list(found.notes)}
        self._write_record()
        self._unfinished(name).unlink(missing_ok=True)

    def keep_seen(self, name: str, of: Any, seen: SeenSoFar) -> None:
        """Keep what was seen of a person in the first pictures of a camera's video, until `add` has all."""
        self.folder.mkdir(exist_ok=True)
        self._write_record()  # so that this folder is gone on with
        write_seen(self._unfinished(name), seen, json.dumps(of))

    def seen(self, name: str, of: Any) -> SeenSoFar:
        """Read what `keep_seen` kept; nothing where it was of something else."""
        return SeenSoFar() if self.anew else read_seen(self._unfinished(name), json.dumps(of))

    def add_silhouette(self, name: str, frame: int, mask: Bool[np.ndarray, "height width"]) -> None:
        """Write where the detector sees the person in one picture of a camera's video."""
        folder = self.folder / SILHOUETTES
        folder.mkdir(parents=True, exist_ok=True)
        write_bytes(mask_file(folder, name, frame), cv2.imencode(".png", 255 * mask.astype(np.uint8))[1].tobytes())

    def _drop_silhouettes(self, name: str, found: FollowedPerson) -> None:
        """Delete those of pictures in which this person was not found: they are of another, who was followed before."""
        shown = {mask_file(self.folder / SILHOUETTES, name, int(frame)) for frame in found.frames[found.found]}
        ours = re.compile(re.escape(name) + r"_\d{5,}\.png")  # not those of a camera whose name begins like this one's
        for file in (self.folder / SILHOUETTES).glob("*.png"):
            if ours.fullmatch(file.name) and file not in shown:
                file.unlink()

    def _known(self, name: str, inputs: dict[str, Any]) -> dict[str, Any] | None:
        """Return what the record says of a camera, if it was looked for the same person in the same video."""
        known = self.record["cameras"].get(name)
        same = known is not None and all(known.get(key) == value for key, value in inputs.items())
        return known if same and not self.anew and self._path(name).is_file() else None

    def people(self, names: Sequence[str]) -> dict[str, FollowedPerson]:
        """Read everybody who has a file."""
        kept = [name for name in names if name in self.record["cameras"] and self._path(name).is_file()]
        return {name: read_person(self._path(name)) for name in kept}

    def finish(self, people: dict[str, FollowedPerson]) -> None:
        """Write the confidences that are believed in the end, and name the folder in `capture.toml`."""
        for name, person in people.items():
            write_person(self._path(name), person)
            believed = person.points[..., 2] > 0
            self.record["cameras"][name] |= {
                "frames": len(person.frames),
                "found": int(person.found.sum()),
                "points_not_believed": int((~believed[person.found]).sum()),
            }
        self._write_record()
        file = self.file.resolve()  # a link stays a link
        text = file.read_bytes().decode("utf-8")
        edited = with_keypoints_line(text, self.folder.name, file)
        if edited != text:
            write_text(file, edited)

    def _unfinished(self, name: str) -> Path:
        return self.folder / f".{name}.unfinished.npz"

    def _path(self, name: str) -> Path:
        return self.folder / f"{name}.json"

    def _write_record(self) -> None:
        write_json(self.file.parent / DETECTION_REPORT, self.record)


def _read_record(file: Path) -> dict[str, Any]:
    """Read the record of an earlier run; empty without one that can be read."""
    try:
        record = json.loads(file.read_text(encoding="utf-8"))
        return record if isinstance(record["folder"], str) and isinstance(record["cameras"], dict) else {}
    except (OSError, ValueError, TypeError, KeyError):
        return {}
