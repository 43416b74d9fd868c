"""What tracking begins with: masks, registered poses and appearance of the selected frames."""

from collections.abc import Callable, Mapping
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, PRNGKeyArray

from jaxmocap._shapes import check_key
from jaxmocap._types import Quality
from jaxmocap.appearance import Appearance, AppearanceSettings, appearance_preset, fit_appearance
from jaxmocap.camera import Cameras
from jaxmocap.capture import Capture
from jaxmocap.character import Character, Pose, pose_vector, skin
from jaxmocap.geometry import facing_cosine
from jaxmocap.observation import Registered, check_key_poses, full_image_ids, key_poses_of
from jaxmocap.registration import Overrides, PersonMasks, Registration, masks_of, register

from ._defaults import MaskRecord, find_person_masks


class Prepared(NamedTuple):
    """Masks that were found, where the capture has none; the registered poses; and the appearance."""

    masks: PersonMasks
    registrations: dict[int, Registration]
    appearance: Appearance


def register_and_learn(
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
    register_key = jax.random.fold_in(key, 1)
    registrations = register(
        capture, cameras, character, selected, key=register_key, overrides=overrides, progress=progress
    )
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


def fit_capture_appearance(
    capture: Capture,
    cameras: Cameras,
    character: Character,
    key_poses: Mapping[int, Pose] | Mapping[int, Registered],
    *,
    key: PRNGKeyArray,
    masks: dict[int, list[Bool[np.ndarray, "height width"] | None]] | None = None,
    settings: AppearanceSettings | None = None,
) -> Appearance:
    """Fit appearance models (Eq. 3) of a capture to its registered selected frames.

    `key_poses` maps each selected frame to its registered pose, or is what `register` returns. Masks are the capture's;
    where it has none, the rendered silhouette takes its place; `masks` replaces them, frame -> one per camera,
    undistorted like the pictures. `key` is for the clusters of the colours, `settings` those of `appearance_preset`.
    Raises `InputError` where there is no pose, or where cameras or frames are not the capture's.
    """
    check_key(key)
    poses = key_poses_of(key_poses)
    check_key_poses(capture, cameras, poses)
    selected = sorted(poses)
    ids, images, facing, person = [], [], [], []
    for frame in selected:
        vertices = skin(character, poses[frame])
        centres = np.asarray(cameras.centres())[:, frame]
        ids.append(full_image_ids(character, vertices, cameras, frame))
        images.append([capture.image(camera, frame) for camera in range(cameras.num_cameras)])
        corners = np.asarray(vertices)[np.asarray(character.faces)]
        facing.append([facing_cosine(corners, centre) for centre in centres])
        found = (
            masks[frame]
            if masks is not None
            else [capture.mask(camera, frame) for camera in range(cameras.num_cameras)]
        )
        person.append([m if m is not None else i >= 0 for m, i in zip(found, ids[-1], strict=True)])
    return fit_appearance(
        ids, images, facing, np.asarray(character.faces), selected, key=key, masks=person, settings=settings
    )


def registration_record(registrations: dict[int, Registration], character: Character, masks: MaskRecord) -> dict:
    """Record what `registration.json` holds: per selected frame the fit, the masks, the pose, metres and degrees."""
    record = {}
    for frame, found in registrations.items():
        vector = np.array(pose_vector(character.skeleton, found.pose), np.float64)
        vector[3:] = np.rad2deg(vector[3:])
        record[str(frame)] = {
            "iou": [None if np.isnan(v) else round(float(v), 4) for v in found.iou],
            "keypoint_rms_m": None if np.isnan(found.keypoint_rms) else round(found.keypoint_rms, 4),
            "searched": found.searched,
            "masks": masks[str(frame)],
            "pose": {name: round(float(v), 5) for name, v in zip(character.skeleton.dof_names, vector, strict=True)},
        }
    return record
