"""One run of an experiment: a method on a capture with some settings and a seed; its record."""

import contextlib
import hashlib
import inspect
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

from jaxmocap._cache import digest
from jaxmocap.baselines import BUILT_IN, METHODS

from ._suite import CaptureSpec

Start = Literal["registered", "truth"]


@dataclass(frozen=True)
class Inputs:
    """What a method is given, beyond the capture.

    Attributes:
        selected: the frames of Gamma used; none: the capture's own, or chosen as `track` does.
        start: where their poses come from; "truth" for captures of a single camera, which cannot be registered.
        camera_degrees: noise added to the cameras' rotations, one draw per camera and seed.
        camera_centimetres: noise added to their places, in the same way.
        mesh_millimetres: noise added to the mesh along its normals.
    """

    selected: tuple[int, ...] = (0,)
    start: Start = "registered"
    camera_degrees: float = 0.0
    camera_centimetres: float = 0.0
    mesh_millimetres: float = 0.0


@dataclass(frozen=True)
class Run:
    """One method on one capture.

    Attributes:
        capture: a suite's capture, or the folder of a real one.
        method: a name of `jaxmocap.baselines.METHODS`, also one that you added there.
        quality: the preset.
        settings: changes of the tracker by dotted names, as `with_settings` takes them.
        appearance: changes of the appearance's settings, in the same way.
        inputs: what the method is given beyond the capture.
        frames: (start, stop); None for all.
        seed: of registration, appearance and tracking.
    """

    capture: CaptureSpec | str
    method: str = "ours"
    quality: Literal["draft", "normal", "paper"] = "normal"
    settings: Mapping[str, Any] = field(default_factory=dict)
    appearance: Mapping[str, Any] = field(default_factory=dict)
    inputs: Inputs = field(default_factory=Inputs)
    frames: tuple[int, int] | None = None
    seed: int = 0

    @property
    def capture_name(self) -> str:
        """Of the suite, or of the folder."""
        return self.capture.name if isinstance(self.capture, CaptureSpec) else Path(self.capture).resolve().name

    def described(self) -> dict[str, Any]:
        """Describe all that tells this run from others, as JSON knows it."""
        capture = self.capture.key if isinstance(self.capture, CaptureSpec) else str(Path(self.capture).resolve())
        return {
            "capture": capture,
            "method": self.method,
            "quality": self.quality,
            "settings": dict(self.settings),
            "appearance": dict(self.appearance),
            "inputs": asdict(self.inputs),
            "frames": None if self.frames is None else list(self.frames),
            "seed": self.seed,
            **({} if self.method in BUILT_IN or self.method not in METHODS else {"own_method": _own_method(self)}),
        }

    @property
    def key(self) -> str:
        """Names the run's files: equal runs of several experiments are done once."""
        digest = hashlib.sha256(json.dumps(self.described(), sort_keys=True).encode()).hexdigest()[:12]
        return f"{self.capture_name}-{self.method}-{digest}"


def _own_method(run: Run) -> str:
    """Hash a method that a user added: its numbers, and the files that it and its name are from. Of what is typed into
    a notebook there is no file."""
    make = METHODS[run.method]
    value = make(run.quality)
    try:
        numbers = digest(value)
    except TypeError:  # it holds things that have no content to compare
        numbers = repr(value)
    found = hashlib.sha256(numbers.encode())
    for part in (make, type(value)):
        with contextlib.suppress(OSError, TypeError):
            found.update(Path(inspect.getsourcefile(part) or "").read_bytes())
    return found.hexdigest()[:12]


@dataclass(frozen=True)
class Trial:
    """A run's place in an experiment: the factor that is varied and its value."""

    experiment: str
    factor: str
    value: str
    run: Run
