"""Following one person through one video of a capture, with what is kept on the way."""

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool

from jaxmocap._types import Report, Say
from jaxmocap.capture import Capture, FrameReader
from jaxmocap.detection import (
    FollowedPerson,
    ModelName,
    PersonModel,
    SeenSoFar,
    follow_person,
    get_weights,
    open_model,
)

_EVERY = 5.0  # seconds after which what was seen is kept


def own_frames(capture: Capture, name: str, span: slice) -> np.ndarray:
    """List the numbers of the frames in the camera's own video."""
    return np.unique(capture.video_frames[capture.camera_names.index(name), span])


class Models:
    """The model, opened when it is first needed."""

    def __init__(self, name: ModelName | None, weights: str | Path | None, say: Say):
        self._arguments = name, weights, say
        self._opened: tuple[PersonModel, dict[str, Any]] | None = None

    def get(self) -> PersonModel:
        return self._open()[0]

    def record(self) -> dict[str, Any]:
        return self._open()[1]

    def _open(self) -> tuple[PersonModel, dict[str, Any]]:
        if self._opened is None:
            weights, say = get_weights(*self._arguments), self._arguments[2]
            if weights.card.weak:
                say(weights.card.weak)
            record = {"name": weights.name, "title": weights.card.title, "licence": weights.card.licence}
            self._opened = open_model(weights), {**record, "sha256": weights.hashes}
        return self._opened


class Keeping:
    """What is kept while a person is followed: every silhouette, and every few seconds what was seen."""

    def __init__(
        self,
        silhouette: Callable[[int, Bool[np.ndarray, "height width"]], None] | None = None,
        begun: SeenSoFar = SeenSoFar(),
        write: Callable[[SeenSoFar], None] = lambda seen: None,
    ):
        self.begun = begun
        self._silhouette, self._write, self._written = silhouette, write, time.monotonic()

    def options(self) -> dict[str, Any]:
        """Return those of `follow_person`."""
        return {"silhouette": self._silhouette, "begun": self.begun, "keep": self._keep}

    def _keep(self, seen: SeenSoFar) -> None:
        if time.monotonic() >= self._written + _EVERY:
            self._write(seen)
            self._written = time.monotonic()


def follow(
    capture: Capture,
    name: str,
    span: slice,
    models: Models,
    at: tuple[float, float] | None,
    say: Say,
    progress: Report,
    keeping: Keeping | None = None,
) -> FollowedPerson:
    """Follow the person through a span of one camera's frames, from where `keeping` was cut off."""
    own = own_frames(capture, name, span)
    index = capture.indices[capture.camera_names.index(name)]
    model, keeping = models.get(), keeping or Keeping()
    before = len(keeping.begun.seen)
    if before:
        say(f"{name}: {before} of {len(own)} pictures were looked at before; it goes on from there.")
    elif at is not None:
        say(f"{name}: the person is looked for at ({at[0]:g}, {at[1]:g}) in frame {own[0]} of {index.path.name}.")

    def pictures() -> Iterator[np.ndarray]:
        reader = FrameReader(index)
        try:
            for done, frame in enumerate(own[before:], before):
                progress(f"detect {name}", done, len(own))
                yield reader.read(int(frame))
        finally:
            reader.close()
        progress(f"detect {name}", len(own), len(own))

    found = follow_person(pictures(), model, at=at, frames=own.tolist(), **keeping.options())
    for note in found.notes:
        say(f"{name}: {note}.")
    missing = own[~found.found]
    if found.found.any() and len(missing):
        say(f"{name}: the person was not found in {len(missing)} of {len(own)} pictures, first in {missing[0]}.")
    return found
