"""Finding the person's keypoints in the videos of a capture, which is completed in place."""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from jaxmocap._results import InputError
from jaxmocap._types import Report, Say
from jaxmocap.capture import Capture, config_path
from jaxmocap.detection import FollowedPerson, ModelName, believed, require_runner

from ._follow_video import Keeping, Models, follow, own_frames
from ._keypoint_store import KeypointStore
from ._view_agreement import agreeing


@dataclass(frozen=True)
class FoundKeypoints:
    """What `detect` found.

    Attributes:
        people: by camera.
        record: as `detection.json` holds it.
        folder: of the keypoint files; None where nothing was written.
    """

    people: dict[str, FollowedPerson]
    record: dict[str, Any]
    folder: Path | None = None


def detect(
    capture: Capture | str | Path,
    *,
    frames: tuple[int, int] | None = None,
    cameras: Sequence[str] | None = None,
    model: ModelName | None = None,
    weights: str | Path | None = None,
    person: Mapping[str, tuple[float, float]] | None = None,
    replace: bool = False,
    skip_empty: bool = False,
    say: Say = lambda sentence: None,
    progress: Report = lambda stage, done, total: None,
) -> FoundKeypoints:
    """Find the keypoints of one person in every video of a capture.

    `capture` is an open `Capture`, and nothing is written; or a capture folder or its `capture.toml`, in which
    `keypoints` then names a folder with one file per camera, and in it `silhouettes`, masks of the person as the
    detector sees them. What is there of the same model, video and person is not
    looked for again, so that a run that was cut off goes on, and other frames are added to it. Where `capture.toml`
    names keypoints of other making, `replace` names the new ones instead, which leaves those on disk; it also begins
    anew. `frames` (A, B) are A to B - 1 of the frames that the cameras share, `cameras` names some of them.

    `model` is "heavy" or "full", by default the better of those that can be had; `weights` a folder, package or bundle
    with its networks, for a machine without a network. The person followed in each video is the largest, or the one at
    the pixel `person[camera]` of the first picture that all videos share, or the first of `frames`. Left and right are
    put right where the model exchanged them for a while. A point that jumps away for a single picture gets confidence
    0; and, where the capture has cameras, one that no other view agrees with.
    `say` takes sentences on what was chosen.

    Raises `InputError` where weights or runner cannot be had, where a camera is not one of the capture's, and where
    nobody is found in a video; what other videos showed is kept. With `skip_empty` such a video has no keypoints
    instead, as long as somebody is found in another one.
    """
    opened = capture if isinstance(capture, Capture) else Capture.open(config_path(capture), with_cameras=False)
    chosen = _cameras(opened, cameras)
    at = _points(opened, person or {}, chosen)
    span = _span(opened, frames)
    require_runner()
    models = Models(model, weights, say)
    if isinstance(capture, Capture):
        looked = {name: follow(opened, name, span, models, at.get(name), say, progress) for name in chosen}
        people = {name: person for name, person in looked.items() if _shown(opened, name, person, skip_empty)}
        return FoundKeypoints(_agreed(opened, people, say), {"model": models.record()})
    store = KeypointStore.open(config_path(capture), replace)
    for name in chosen:
        inputs = {
            "video": _hash(opened.videos[opened.camera_names.index(name)]),
            "person": list(at[name]) if name in at else None,
        }
        own = own_frames(opened, name, span)
        if store.has(name, inputs, model, own):
            continue
        of = {**inputs, "model": models.record(), "frames": own.tolist()}
        keeping = Keeping(partial(store.add_silhouette, name), store.seen(name, of), partial(store.keep_seen, name, of))
        found = follow(opened, name, span, models, at.get(name), say, progress, keeping)
        if _shown(opened, name, found, skip_empty):
            store.add(name, inputs, models.record(), found)
    everybody = {
        name: believed(person, opened.recorded_sizes[opened.camera_names.index(name)])
        for name, person in store.people(opened.camera_names).items()
    }
    if not everybody:
        listed = ", ".join(chosen)
        raise InputError(f"nobody was found in any video ({listed}); the person must be whole and not too small")
    people = _agreed(_with_cameras(capture, opened, say), everybody, say)
    store.finish(people)
    return FoundKeypoints({name: people[name] for name in chosen if name in people}, store.record, store.folder)


def _cameras(capture: Capture, names: Sequence[str] | None) -> tuple[str, ...]:
    for name in names or ():
        _known(capture, name, "cameras")
    return capture.camera_names if not names else tuple(one for one in capture.camera_names if one in names)


def _known(capture: Capture, name: str, option: str) -> None:
    if name not in capture.camera_names:
        raise InputError(
            f"{option} names {name!r}, which is no camera of capture '{capture.name}'; it has "
            f"{', '.join(capture.camera_names)}"
        )


def _points(
    capture: Capture, person: Mapping[str, tuple[float, float]], chosen: Sequence[str]
) -> dict[str, tuple[float, float]]:
    """Where the person is in each camera, inside its pictures."""
    for name, (x, y) in person.items():
        _known(capture, name, "person")
        width, height = capture.recorded_sizes[capture.camera_names.index(name)]
        if not (0 <= x < width and 0 <= y < height):
            raise InputError(
                f"person is at ({x:g}, {y:g}) of {name}, outside its pictures of {width} x {height} pixels; give a "
                "pixel on the person in the first picture that all videos share"
            )
    return {name: (float(x), float(y)) for name, (x, y) in person.items() if name in chosen}


def _span(capture: Capture, frames: tuple[int, int] | None) -> slice:
    start, stop = frames or (0, capture.num_frames)
    if not 0 <= start < stop <= capture.num_frames:
        raise InputError(f"frames {start}:{stop} are not within the {capture.num_frames} frames of '{capture.name}'")
    return slice(start, stop)


def _shown(capture: Capture, name: str, person: FollowedPerson, skip_empty: bool) -> bool:
    """Whether anybody is found in a video; a refusal where nobody is and that is not to be skipped."""
    if not (shown := bool(person.found.any())) and not skip_empty:
        file = capture.videos[capture.camera_names.index(name)].name
        raise InputError(
            f"nobody was found in the {len(person.frames)} pictures of camera {name} ({file}); choose --frames in "
            "which the person is whole and not too small, or leave the camera out with --cameras"
        )
    return shown


def _with_cameras(path: str | Path, opened: Capture, say: Say) -> Capture:
    """Open the capture with cameras, where it has any that can be read."""
    try:
        return Capture.open(config_path(path)).as_recorded()
    except InputError as error:
        say(f"The views were not held against each other: {error}.")
        return opened


def _agreed(capture: Capture, people: dict[str, FollowedPerson], say: Say) -> dict[str, FollowedPerson]:
    """People with what no other view agrees with taken out, where the capture has cameras."""
    if capture.cameras_path is None or len(people) < 2:
        return people
    agreed, share = agreeing(capture.as_recorded(), people)
    if agreed is people and share > 0:
        say(
            f"{share:.0%} of the points do not lie where another view sees them, so that cameras or offsets are rather "
            "wrong than the points; no point was taken out for it."
        )
    for name, person in agreed.items():
        count = int((people[name].points[..., 2] > 0).sum() - (person.points[..., 2] > 0).sum())
        if count:
            say(f"{name}: {count} points agree with no other view, and got confidence 0.")
    return agreed


def _hash(video: Path) -> str:
    with video.open("rb") as file:
        return hashlib.file_digest(file, "blake2b").hexdigest()[:32]
