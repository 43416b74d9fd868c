"""Who is tracked: the actor that is given, or else the built-in body, made to the measure of the filmed person."""

from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import PRNGKeyArray

from jaxmocap._cache import cached_stage, code_hash, machine
from jaxmocap._results import InputError
from jaxmocap._runtime import versions
from jaxmocap._types import Report, Say
from jaxmocap.capture import Capture, Finding, choose_frames, content_hash
from jaxmocap.character import Character
from jaxmocap.registration import (
    FEWEST_FRAMES,
    PersonMask,
    SegmentationSettings,
    fit_character,
    measurable,
    segment_person,
    usable_frames,
)
from jaxmocap.rigging import body, open_actor

MOST_FRAMES, MOST_MASKED = 6, 2
"""Well-spread frames whose keypoints tell the lengths, and those of them whose outlines tell the girths where no
detector has left silhouettes: with these it is all of them."""


class MadeBody(NamedTuple):
    """A body made to measure.

    Attributes:
        character: the body.
        record: what it was made of, as a result's report holds it; None for an actor that was given.
        sentence: the same in words.
        camera_scale: by which the cameras' positions are to be multiplied for the body to belong to them.
    """

    character: Character
    record: dict | None = None
    sentence: str = ""
    camera_scale: float = 1.0


def character_of(
    capture: Capture,
    actor: str | Path | None = None,
    height: float | None = None,
    *,
    scale_cameras: bool = False,
    within: tuple[int, int | None] = (0, None),
    key: PRNGKeyArray | None = None,
    say: Say | None = None,
    progress: Report | None = None,
    cache: bool = True,
) -> MadeBody:
    """Open the character in the file `actor`, or else the capture's, or make one to the person's measure.

    A bare mesh is rigged. Where there is no actor, the built-in body is fitted to the keypoints of up to `MOST_FRAMES`
    well-spread frames and to the person's outlines there (without a detector's silhouettes in `MOST_MASKED` of them),
    `height` metres tall where that is known. With one camera it is the built-in body of that height. `scale_cameras`
    says that the height is known better than the cameras' scale: where there are outlines the body is as tall as they
    show it, then it and the cameras are scaled to the height (`MadeBody.camera_scale`). Only frames `within` (first,
    end) are looked at.

    `say` is told of what was assumed. Raises `InputError` where an actor and a height are given, for a height that no
    person has, and where nothing tells how tall the person is.
    """
    tell = say or (lambda sentence: None)
    if actor is not None or capture.actor is not None:
        refuse_height_beside_actor(capture, actor, height)
        named = actor if actor is not None else capture.actor
        assert named is not None
        return MadeBody(open_actor(named, say))
    generic = body(height)
    frames = _frames(capture, within)
    if not measurable(capture, frames):
        why = _too_few(capture, len(frames))
        if height is None:
            raise InputError(
                f"capture '{capture.name}' names no actor, and a body cannot be made to measure: {why}. Say how tall "
                'the person is (--height METRES), or add actor = "FILE.glb" to capture.toml.'
            )
        tell(f"The built-in body, {height:.2f} m tall, stands for the person: {why}.")
        return MadeBody(generic, {"height_m": round(height, 4), "frames": [], "masks": 0}, "")
    key = jax.random.key(0) if key is None else key
    scale_cameras = scale_cameras and height is not None
    make = lambda: _fitted(capture, generic, frames, height, scale_cameras, key, progress)  # noqa: E731
    inputs = {
        "capture": content_hash(capture),
        "frames": list(frames),
        "height": height,
        "choice of scaling cameras": scale_cameras,
        "key": jax.random.key_data(key).tolist(),
        "version of jaxmocap": code_hash(),
        "set of packages": versions(),
        "machine": machine(),
    }
    made = cached_stage("body", inputs, make) if cache else make()
    tell(made.sentence)
    return made


def refuse_height_beside_actor(capture: Capture, actor: str | Path | None, height: float | None) -> None:
    """Raise `InputError` where a height is given and an actor too."""
    if height is not None and (actor or capture.actor) is not None:
        raise InputError(
            f"a height is given ({height:g} m), which is for the body that is made where there is no actor, and an "
            f"actor too ({actor or capture.actor}); leave one of them out."
        )


def no_actor(capture: Capture) -> Finding:
    """Say what comes of a capture that names no actor, as `check` does."""
    frames = [] if capture.cameras_path is None else _frames(capture)
    if capture.cameras_path is None:
        told = "no actor is named: the built-in body is made to measure once there are cameras and keypoints"
        return Finding("note", "actor", told)
    if measurable(capture, frames):
        own = ", ".join(str(capture.video_frames[0, frame]) for frame in frames)
        told = (
            f"no actor is named: the built-in body is made to measure at frames {own}; say how tall the person is with "
            "--height METRES where you know it"
        )
        return Finding("note", "actor", told)
    told = (
        f"no actor is named, and {_too_few(capture, len(frames))}: track needs --height METRES, or name a skinned "
        ".glb or .gltf file or a mesh as actor"
    )
    return Finding("warning", "actor", told)


def _frames(capture: Capture, within: tuple[int, int | None] = (0, None)) -> tuple[int, ...]:
    """Frames whose keypoints can tell the person's lengths: the selected ones, and others that stand for all."""
    if capture.num_cameras < 2 or capture.keypoints_folder is None:
        return ()
    chosen = choose_frames(capture, capture.cameras, MOST_FRAMES, within).frames
    selected = set(capture.selected_frames or ()).intersection(range(capture.num_frames)[slice(*within)])
    return usable_frames(capture, capture.cameras, sorted({*chosen, *selected}))


def _too_few(capture: Capture, count: int) -> str:
    if capture.num_cameras < 2:
        return "one camera does not tell how long a person's limbs are"
    if capture.keypoints_folder is None:
        return "there are no keypoints"
    found = "no frame has" if count == 0 else f"only {count} frame{'s have' if count > 1 else ' has'}"
    return f"{found} keypoints in two views, and {FEWEST_FRAMES} such frames are needed"


def _fitted(
    capture: Capture,
    generic: Character,
    frames: tuple[int, ...],
    height: float | None,
    scale_cameras: bool,
    key: PRNGKeyArray,
    progress: Report | None,
) -> MadeBody:
    """Lengths from keypoints, then outlines found with that body, then lengths and girths from both."""
    capture = capture.one_way_up()
    cameras, tell = capture.cameras, progress or (lambda stage, done, total: None)
    steps = lambda stage, done, total: tell(f"body: {stage}", done, total)  # noqa: E731
    held = None if scale_cameras else height
    rough = fit_character(capture, cameras, generic, frames, height=held, progress=steps)
    views = range(capture.num_cameras)
    outlined = [frame for frame in frames if any(capture.silhouette(camera, frame) is not None for camera in views)]
    settings, start = SegmentationSettings(rounds=0), rough.poses  # silhouettes do better than a body fitted once more
    if not outlined:
        selected = [frame for frame in capture.selected_frames or frames if frame in frames]
        outlined = [selected[i] for i in sorted({round(x) for x in np.linspace(0, len(selected) - 1, MOST_MASKED)})]
        settings, start = SegmentationSettings(), None
    found = segment_person(
        capture, cameras, rough.character, outlined, key=key, start=start, settings=settings, progress=steps
    )
    sure = {frame: [one.mask if _sure(one) else None for one in row] for frame, row in found.items()}
    scale_cameras = scale_cameras and any(mask is not None for row in sure.values() for mask in row)
    held = None if scale_cameras else height
    fit = fit_character(
        capture.with_masks(sure), cameras, generic, frames, height=held, start=rough.poses, progress=steps
    )
    if scale_cameras and height is not None:
        fit = fit.scaled_to(height)
    tall = round(fit.height, 4)
    own = [int(capture.video_frames[0, frame]) for frame in frames]
    record = {
        "height_m": tall,
        "frames": own,
        "masks": fit.num_masks,
        "keypoint_error_m": round(fit.keypoint_error, 4),
    }
    sentence = (
        f"The built-in body was made to measure at {len(frames)} frames with {fit.num_masks} outlines: {tall:.2f} m "
        f"tall{'' if height is None else f' ({height:.2f} m was given)'}, keypoints off by "
        f"{100 * fit.keypoint_error:.1f} cm in the median."
    )
    return MadeBody(fit.character, record, sentence, fit.camera_scale)


def _sure(person: PersonMask) -> bool:
    return person.confidence is None or person.confidence.value >= SegmentationSettings().warn_below
