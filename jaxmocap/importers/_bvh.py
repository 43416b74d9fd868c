"""Reading BVH."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import NoReturn

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from jaxmocap._results import InputError
from jaxmocap.character import rig_of

from ._clip import JointClip, meshless

_CHANNELS = {f"{axis}{kind}" for axis in "XYZ" for kind in ("position", "rotation")}
_MOST_JOINTS = 1000
_LONGEST_NAME = 20  # words


@dataclass
class _Joint:
    name: str
    parent: int
    offset: Float[np.ndarray, "3"] = field(default_factory=lambda: np.zeros(3))
    channels: tuple[str, ...] = ()


class _File:
    """The words of a file with their lines; `fail` names the file."""

    def __init__(self, path: Path):
        self.path = path
        if not path.is_file():
            raise InputError(f"{path} does not exist; give the path of a .bvh file.")
        self.lines = path.read_text(encoding="utf-8-sig", errors="replace").splitlines()
        self.line = 0
        self._words = self._all_words()

    def fail(self, message: str) -> NoReturn:
        raise InputError(f"{self.path}: {message}.")

    def _all_words(self) -> Iterator[str]:
        for number, line in enumerate(self.lines, start=1):
            self.line = number
            yield from line.split()

    def word(self, expected: str = "") -> str:
        found = next(self._words, None)
        if found is None:
            self.fail(f"ends where {expected or 'more'} was expected; the file is cut short")
        if expected and found.upper() != expected.upper():
            self.fail(
                f"line {self.line} has {found[:40]!r} where {expected} was expected; it is no BVH file, or damaged"
            )
        return found

    def rest(self) -> Iterator[str]:
        """Return all words that are left."""
        return self._words

    def number(self) -> float:
        found = self.word()
        try:
            value = float(found)
        except ValueError:
            value = np.nan
        if not np.isfinite(value):
            self.fail(f"line {self.line} has {found[:40]!r} where a number was expected; the file is damaged")
        return value

    def count(self) -> int:
        value = self.number()
        if value != int(value) or value < 0:
            self.fail(f"line {self.line} has {value:g} where a whole number was expected; the file is damaged")
        return int(value)


def read_bvh(path: Path, mapping: str | Path | Mapping[str, str] | None) -> JointClip:
    """Read the clip of a BVH file.

    Any hierarchy and any order of channels are read, positions of inner joints included. The pose in which all angles
    are zero is its rest pose; up is z if that stands along z, else y.
    """
    file = _File(path)
    joints = _hierarchy(file)
    frames, seconds = _motion(file, joints)
    places = np.zeros((len(joints), 3))
    for number, joint in enumerate(joints):
        places[number] = joint.offset + (places[joint.parent] if joint.parent >= 0 else 0)
    still = np.tile(np.eye(4), (len(joints), 1, 1))
    still[:, :3, 3] = places
    raw = meshless([joint.name for joint in joints], [joint.parent for joint in joints], still)
    rig = rig_of(file, raw, still, mapping)
    up = "z" if rig.rest_from_file[1, 2] > 0.7 else "y"
    return JointClip(rig, _worlds(joints, frames), seconds * np.arange(len(frames)), up)


def _hierarchy(file: _File) -> list[_Joint]:
    file.word("HIERARCHY")
    joints: list[_Joint] = []
    open_: list[int] = []
    in_tip = False
    while True:
        word = file.word()
        kind = word.upper()
        if kind == "ROOT" or (kind == "JOINT" and open_):
            if kind == "ROOT" and joints:
                file.fail(f"line {file.line} begins a second skeleton; one person per file is read")
            words = []
            while (word := file.word()) != "{" and len(words) < _LONGEST_NAME:
                words.append(word)
            joints.append(_Joint(" ".join(words), open_[-1] if open_ else -1))
            open_.append(len(joints) - 1)
            if len(joints) > _MOST_JOINTS:
                file.fail(f"has more than {_MOST_JOINTS} joints")
        elif kind == "END":
            file.word("Site")
            file.word("{")
            in_tip = True
        elif kind == "OFFSET" and (open_ or in_tip):
            offset = np.array([file.number() for _ in range(3)])
            if not in_tip:
                joints[open_[-1]].offset = offset
        elif kind == "CHANNELS" and open_ and not in_tip:
            channels = tuple(file.word().capitalize() for _ in range(min(file.count(), 9)))
            unknown = [channel for channel in channels if channel not in _CHANNELS]
            if unknown:
                file.fail(f"line {file.line} names the channel {unknown[0][:40]!r}; Xposition to Zrotation are known")
            joints[open_[-1]].channels = channels
        elif word == "}" and (in_tip or open_):
            if in_tip:
                in_tip = False
            else:
                open_.pop()
        elif kind == "MOTION" and joints and not open_:
            return joints
        else:
            file.fail(f"line {file.line} has {word[:40]!r}, which does not belong there; it is no BVH file, or damaged")


def _motion(file: _File, joints: list[_Joint]) -> tuple[Float[np.ndarray, "frame channel"], float]:
    file.word("Frames:")
    count = file.count()
    file.word("Frame")
    file.word("Time:")
    seconds = file.number()
    if seconds <= 0:
        file.fail(f"line {file.line} has the frame time {seconds:g}; more than 0 seconds were expected")
    width = sum(len(joint.channels) for joint in joints)
    words = list(file.rest())
    if count == 0 or len(words) < count * width:
        file.fail(f"announces {count} frames of {width} numbers and holds {len(words)} numbers; it is cut short")
    try:
        frames = np.array(words[: count * width], np.float64).reshape(count, width)
    except ValueError:
        frames = np.full((1, 1), np.nan)
    if not np.isfinite(frames).all():
        file.fail("has frames with something that is not a number; the file is damaged")
    return frames, seconds


def _worlds(joints: list[_Joint], frames: Float[np.ndarray, "frame channel"]) -> Float[np.ndarray, "frame joint 4 4"]:
    worlds = np.tile(np.eye(4), (len(frames), len(joints), 1, 1))
    start = 0
    for number, joint in enumerate(joints):
        local = np.tile(np.eye(4), (len(frames), 1, 1))
        local[:, :3, 3] = joint.offset
        values = frames[:, start : start + len(joint.channels)]
        start += len(joint.channels)
        for channel, column in zip(joint.channels, values.T, strict=True):
            if channel.endswith("position"):
                local[:, "XYZ".index(channel[0]), 3] = column
            else:
                turn = Rotation.from_euler(channel[0].lower(), column[:, None], degrees=True).as_matrix()
                local[:, :3, :3] = local[:, :3, :3] @ turn
        worlds[:, number] = worlds[:, joint.parent] @ local if joint.parent >= 0 else local
    return worlds
