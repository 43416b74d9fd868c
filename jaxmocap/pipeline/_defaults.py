"""What a capture does not say about its selected frames: which they are, and where the person is in them."""

from collections.abc import Callable

from jaxtyping import PRNGKeyArray

from jaxmocap._results import InputError
from jaxmocap.capture import Capture, choose_frames
from jaxmocap.character import Character
from jaxmocap.registration import Overrides, PersonMask, PersonMasks, SegmentationSettings, masks_of, segment_person

MaskRecord = dict[str, dict[str, dict]]
"""Frame -> camera -> where the mask comes from and how sure it is, as reports hold it."""

_SETTINGS = SegmentationSettings()


def with_selected_frames(
    capture: Capture,
    overrides: Overrides | None = None,
    say: Callable[[str], None] | None = None,
    within: tuple[int, int | None] = (0, None),
) -> tuple[Capture, dict]:
    """Choose selected frames from the capture's keypoints if it names none; return it with a record of that.

    They are `within` (first, end). Frames whose pose is given by `overrides` are among those chosen; where the capture
    names its own, `InputError` is raised for a pose of another frame.
    """
    if capture.selected_frames is not None:
        if unknown := sorted(set(overrides or {}) - set(capture.selected_frames)):
            raise InputError(
                f"a pose is given for frame {unknown[0]}, which is not registered; the selected frames of capture "
                f"'{capture.name}' are {', '.join(map(str, capture.selected_frames))}."
            )
        return capture, {"frames": _own_numbers(capture), "source": "capture"}
    chosen = choose_frames(capture, capture.cameras, within=within)
    given = [frame for frame in overrides or {} if frame < capture.num_frames]
    complete = capture.with_selected_frames((*chosen.frames, *given))
    numbers = _own_numbers(complete)
    if say is not None:
        say(
            f"capture '{capture.name}' names no selected_frames; {', '.join(map(str, numbers))} "
            f"{'is' if len(numbers) == 1 else 'are'} used: {chosen.reason}."
        )
    return complete, {"frames": numbers, "source": "chosen", "reason": chosen.reason}


def _own_numbers(capture: Capture) -> list[int]:
    """Give the selected frames their numbers in the first camera's video, like in `capture.toml`."""
    return [int(capture.video_frames[0, frame]) for frame in capture.selected_frames or ()]


def with_person_masks(
    capture: Capture,
    character: Character,
    *,
    key: PRNGKeyArray,
    overrides: Overrides | None = None,
    find: bool = True,
    say: Callable[[str], None] | None = None,
    progress: Callable[[str, int, int], None] | None = None,
) -> tuple[Capture, PersonMasks]:
    """Give the capture a mask of the person in every view of every selected frame; return it with these masks.

    Those that are missing are found, unless `find` is off; then nothing changes and the registered body stands for the
    person.
    """
    found = find_person_masks(capture, character, key=key, overrides=overrides, progress=progress) if find else {}
    say_doubts(capture, found, say)
    return (capture.with_masks(masks_of(found)) if found else capture), found


def find_person_masks(
    capture: Capture,
    character: Character,
    *,
    key: PRNGKeyArray,
    overrides: Overrides | None = None,
    progress: Callable[[str, int, int], None] | None = None,
) -> PersonMasks:
    """Find masks for the selected frames that lack one."""
    frames = capture.selected_frames or (0,)
    cameras = range(capture.num_cameras)
    missing = [frame for frame in frames if any(capture.mask(camera, frame) is None for camera in cameras)]
    if not missing:
        return {}
    return segment_person(
        capture,
        capture.cameras,
        character,
        missing,
        key=key,
        overrides=overrides,
        settings=_SETTINGS,
        progress=progress or (lambda stage, done, total: None),
    )


def say_doubts(capture: Capture, found: PersonMasks, say: Callable[[str], None] | None) -> None:
    """Tell which masks are doubtful."""
    for sentence in doubts(capture, found, _SETTINGS.warn_below):
        if say is not None:
            say(sentence)


def doubts(capture: Capture, found: PersonMasks, below: float) -> list[str]:
    """Write a sentence for all masks whose confidence is low, or none."""
    weak = [
        f"{capture.camera_names[camera]} frame {int(capture.video_frames[camera, frame])} ({one.confidence.value:.2f})"
        for frame, row in found.items()
        for camera, one in enumerate(row)
        if one.confidence is not None and one.confidence.value < below
    ]
    if not weak:
        return []
    return [
        f"the person's outline is doubtful in {', '.join(weak)}: look at it with jaxmocap segment, and give a mask "
        "where it is wrong."
    ]


def mask_record(capture: Capture, found: PersonMasks) -> MaskRecord:
    """Record every mask per selected frame and camera.

    It is "given", "found" with its confidence, or "silhouette", where there is none and the registered body stands for
    the person.
    """

    def one(frame: int, camera: int) -> dict:
        row = found.get(frame)
        if row is not None:
            return person_record(row[camera])
        return {"source": "silhouette" if capture.mask(camera, frame) is None else "given"}

    return {
        str(frame): {name: one(frame, camera) for camera, name in enumerate(capture.camera_names)}
        for frame in capture.selected_frames or (0,)
    }


def person_record(person: PersonMask) -> dict:
    """Record one mask as a report holds it."""
    if person.confidence is None:
        return {"source": person.source}
    parts = {name: round(float(value), 3) for name, value in person.confidence._asdict().items()}
    return {"source": person.source, "confidence": round(person.confidence.value, 3), **parts}
