"""What tracking begins with: masks, registered poses and appearance of the selected frames."""

from collections.abc import Callable
from typing import NamedTuple

import jax
from jaxtyping import PRNGKeyArray

from jaxmocap._complete import find_person_masks
from jaxmocap.appearance import Appearance
from jaxmocap.capture import Capture
from jaxmocap.character import Character
from jaxmocap.observation import fit_capture_appearance
from jaxmocap.track import (
    Overrides,
    PersonMasks,
    Quality,
    Registration,
    appearance_preset,
    key_poses_of,
    masks_of,
    register,
)


class Prepared(NamedTuple):
    """Masks that were found, where the capture has none; the registered poses; and the appearance."""

    masks: PersonMasks
    registrations: dict[int, Registration]
    appearance: Appearance


def prepare(
    capture: Capture,
    character: Character,
    key: PRNGKeyArray,
    overrides: Overrides | None,
    quality: Quality,
    find_masks: bool,
    progress: Callable[[str, int, int], None] | None = None,
) -> Prepared:
    """Find masks where there are none (if `find_masks`), register the selected frames and fit the appearance."""
    tell = progress or (lambda stage, done, total: None)
    found: PersonMasks = {}
    if find_masks:
        mask_key = jax.random.fold_in(key, 4)
        found = find_person_masks(capture, character, key=mask_key, overrides=overrides, progress=progress)
        capture = capture.with_masks(masks_of(found))
    cameras, selected = capture.cameras, capture.selected_frames or (0,)
    tell("register", 0, len(selected))
    registrations: dict[int, Registration] = {}
    for number, frame in enumerate(selected):
        registrations |= register(
            capture, cameras, character, (frame,), key=jax.random.fold_in(key, 1), overrides=overrides
        )
        tell("register", number + 1, len(selected))
    tell("appearance", 0, 1)
    appearance = fit_capture_appearance(
        capture,
        cameras,
        character,
        key_poses_of(registrations),
        key=jax.random.fold_in(key, 2),
        settings=appearance_preset(quality),
    )
    tell("appearance", 1, 1)
    return Prepared(found, registrations, appearance)
