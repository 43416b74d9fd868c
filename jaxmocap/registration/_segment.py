"""Masks of the person at selected frames that have none, found in turns with the registration (sec. 3.2, where the
paper draws them by hand)."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import jax
import numpy as np
from jaxtyping import Bool, PRNGKeyArray

from jaxmocap._runtime import side_by_side
from jaxmocap.camera import Cameras
from jaxmocap.capture import Capture, choose_frames
from jaxmocap.character import Character, Pose, skin
from jaxmocap.observation import (
    CutSettings,
    MaskConfidence,
    OtherFrame,
    cut_person,
    full_image_ids,
    mask_confidence,
    other_frame,
    person_prior,
    standing_still,
)

from ._fit_silhouette import RegistrationSettings
from ._pose_file import Overrides
from ._register import register


@dataclass(frozen=True)
class SegmentationSettings:
    """How the person's masks are found. Not in the paper, where they are drawn by hand.

    Attributes:
        rounds: times at most that the body is fitted to the masks and they are cut again.
        settled: 1 - intersection over union below which no mask counts as changed.
        others: frames of each camera that tell what stands still.
        warn_below: confidence below which a mask is worth a look.
        cut: settings of the graph cut.
    """

    rounds: int = 2
    settled: float = 0.01
    others: int = 10
    warn_below: float = 0.5
    cut: CutSettings = field(default_factory=CutSettings)


@dataclass(frozen=True)
class PersonMask:
    """A mask of the undistorted image, where it comes from, and how sure it is: None for one that was given."""

    mask: Bool[np.ndarray, "height width"]
    confidence: MaskConfidence | None

    @property
    def source(self) -> str:
        """Given with the capture, or found in the images."""
        return "given" if self.confidence is None else "found"


PersonMasks = dict[int, tuple[PersonMask, ...]]
"""Frame -> one mask per camera."""


def segment_person(
    capture: Capture,
    cameras: Cameras,
    character: Character,
    frames: Sequence[int] | None = None,
    *,
    key: PRNGKeyArray | None = None,
    overrides: Overrides | None = None,
    start: Mapping[int, Pose] | None = None,
    settings: SegmentationSettings | None = None,
    registration: RegistrationSettings | None = None,
    progress: Callable[[str, int, int], None] = lambda stage, done, total: None,
) -> PersonMasks:
    """Find masks of the person at the selected frames, or at `frames`; the capture's own are kept where it has them.

    The body is registered from the keypoints; it and they say roughly where the person is; GrabCut by local colours
    finds the outline (`cut_person`), with a detector's silhouettes where there are any; the body is fitted to it; and
    so on, frames side by side. A body that is not the person's own will do. `start` are poses to begin with, by frame;
    `progress` hears "masks", how many frames are done, and of how many. `capture.with_masks(masks_of(found))` uses the
    masks from then on. Raises `InputError` where registration does.
    """
    settings = SegmentationSettings() if settings is None else settings
    registration = RegistrationSettings() if registration is None else registration
    key = jax.random.key(0) if key is None else key
    if frames is None:
        frames = capture.selected_frames or choose_frames(capture, cameras).frames
    rough = replace(registration, search_below=0.0, view_flow=0)  # holding views against each other mends no mask
    others: dict[tuple[int, int], OtherFrame] = {}

    def one(frame: int) -> tuple[PersonMask, ...]:
        given = [capture.mask(camera, frame) for camera in range(capture.num_cameras)]
        if all(mask is not None for mask in given):
            return tuple(PersonMask(mask, None) for mask in given if mask is not None)

        def fitted(masks: list, start: Pose | None) -> Pose:
            known = capture.with_masks({frame: masks})
            found = register(
                known, cameras, character, (frame,), key=key, overrides=overrides, start=start, settings=rough
            )
            return found[frame].pose

        cutter = _Cutter(capture, cameras, character, frame, given, settings, others)
        pose = start[frame] if start and frame in start else fitted(given, None)
        masks = cutter.cut(pose)
        for _ in range(settings.rounds):
            pose = fitted(masks, pose)
            last, masks = masks, cutter.cut(pose)
            if max(_changed(a, b) for a, b in zip(last, masks, strict=True)) <= settings.settled:
                break
        return cutter.judged(pose, masks)

    progress("masks", 0, len(frames))
    result: PersonMasks = {}
    for frame, masks in zip(frames, side_by_side(one, frames), strict=True):
        result[frame] = masks
        progress("masks", len(result), len(frames))
    return result


def masks_of(found: PersonMasks) -> dict[int, list[Bool[np.ndarray, "height width"]]]:
    """Return the masks alone, as `Capture.with_masks` takes them."""
    return {frame: [person.mask for person in row] for frame, row in found.items()}


class _Cutter:
    """The images of one frame, cut around one pose after another."""

    def __init__(
        self,
        capture: Capture,
        cameras: Cameras,
        character: Character,
        frame: int,
        given: list[Bool[np.ndarray, "height width"] | None],
        settings: SegmentationSettings,
        others: dict[tuple[int, int], OtherFrame],
    ):
        self._capture, self._cameras, self._character, self._frame = capture, cameras, character, frame
        self._given, self._settings, self._others = given, settings, others
        self._still: dict[int, np.ndarray] = {}

    def _view(
        self, camera: int, silhouette: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray | None]:
        """Return image, prior, what stands still, which is worked out once, and where a detector sees the person."""
        image = self._capture.image(camera, self._frame)
        prior = person_prior(silhouette, self._capture.keypoints(camera, self._frame), self._settings.cut)
        if camera not in self._still:
            times = np.linspace(0, self._capture.num_frames - 1, self._settings.others + 1).round().astype(int)
            others = [self._other(camera, int(time)) for time in np.unique(times) if time != self._frame]
            self._still[camera] = standing_still(image, prior, others)
        return image, prior, self._still[camera], self._capture.silhouette(camera, self._frame)

    def _other(self, camera: int, frame: int) -> OtherFrame:
        if (camera, frame) not in self._others:
            self._others[camera, frame] = other_frame(self._capture.image(camera, frame))
        return self._others[camera, frame]

    def _silhouettes(self, pose: Pose) -> list[np.ndarray]:
        vertices = skin(self._character, pose)
        return [ids >= 0 for ids in full_image_ids(self._character, vertices, self._cameras, self._frame)]

    def cut(self, pose: Pose) -> list[np.ndarray]:
        masks = []
        for camera, (given, silhouette) in enumerate(zip(self._given, self._silhouettes(pose), strict=True)):
            if given is not None:
                masks.append(given)
                continue
            image, prior, still, seen = self._view(camera, silhouette)
            masks.append(cut_person(image, prior, still, self._settings.cut, seen=seen))
        return masks

    def judged(self, pose: Pose, masks: list[np.ndarray]) -> tuple[PersonMask, ...]:
        judged = []
        for camera, silhouette in enumerate(self._silhouettes(pose)):
            mask, sure = masks[camera], None
            if self._given[camera] is None:
                image, prior, still, seen = self._view(camera, silhouette)
                sure = mask_confidence(image, mask, silhouette, prior, still, self._settings.cut, seen=seen)
            judged.append(PersonMask(mask, sure))
        return tuple(judged)


def _changed(before: np.ndarray, after: np.ndarray) -> float:
    return 1 - float((before & after).sum()) / max(float((before | after).sum()), 1.0)
