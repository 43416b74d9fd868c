"""Registration of the mesh at the selected frames (sec. 3.2): keypoints, then contours and masks, then search if
needed."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, PRNGKeyArray

from jaxmocap._results import InputError
from jaxmocap._runtime import side_by_side
from jaxmocap._shapes import check_key
from jaxmocap.camera import Cameras
from jaxmocap.capture import Capture, check_subject, choose_frames
from jaxmocap.character import Character, Pose, filled_up, rest_pose, skin
from jaxmocap.energies import keypoint_rays
from jaxmocap.geometry import intersection_over_union
from jaxmocap.observation import (
    BODY_25,
    FACE,
    FrameProblem,
    Surface,
    build_problem,
    draw,
    frame_rectangle,
    image_edges,
    mask_edges,
    stacked_keypoints,
    surface_of,
)

from ._fit_silhouette import (
    RegistrationSettings,
    fit_between_views,
    fit_to_masks,
    search_silhouettes,
)
from ._inverse_kinematics import inverse_kinematics, keypoint_distance
from ._pose_file import Overrides, apply_overrides

FACE_WEIGHT = 1.0
"""Of the keypoints of the face: an outline hardly tells where a head looks, and had turned one by 70 degrees."""

KEYPOINT_SCALE = 0.03
"""Metres between a landmark and a keypoint's ray that count as 1, as 0.02 do for a point of an outline: an arm before
the body has no outline of its own, and only its keypoints keep it from that of the body."""


@dataclass(frozen=True)
class Registration:
    """The pose at one selected frame, and how well it fits: intersection over union per view (NaN without a mask), RMS
    distance to the keypoints' rays in metres, and whether annealing was needed."""

    frame: int
    pose: Pose
    iou: Float[np.ndarray, "camera"]
    keypoint_rms: float
    searched: bool


def register_frame(
    capture: Capture,
    cameras: Cameras,
    character: Character,
    frame: int,
    *,
    key: PRNGKeyArray,
    surface: Surface | None = None,
    start: Pose | None = None,
    overrides: dict[str, float] | None = None,
    settings: RegistrationSettings | None = None,
) -> Registration:
    """Find the pose of the mesh at one selected frame.

    `start` replaces the inverse kinematics (needed when the frame has no keypoints). `overrides` fixes single DoFs.
    """
    settings = RegistrationSettings() if settings is None else settings
    character = filled_up(character)
    views = range(cameras.num_cameras)
    view = cameras.at(frame)
    keypoints = [capture.keypoints(c, frame) for c in views]
    if start is None and all(points is None for points in keypoints):
        if not overrides:
            name = f"{capture.camera_names[0]}_{int(capture.video_frames[0, frame]):05d}_keypoints.json"
            raise InputError(
                f"frame {frame} of capture '{capture.name}' has no keypoints and no initial pose; add keypoints of "
                f"this frame, best in two cameras ({name} and so on), or give its pose with --pose."
            )
        start = rest_pose(character.skeleton)
    if start is None:
        pose, _ = inverse_kinematics(
            character, view, keypoints, settings.refiner, where=f"frame {frame} of capture '{capture.name}'"
        )
    else:
        pose = start
    fixed: list[int] = []
    if overrides:
        pose, fixed = apply_overrides(character, pose, overrides)
    seen = jnp.asarray(stacked_keypoints(keypoints))
    rays = partial(keypoint_rays, character.skeleton, view.intrinsics, view.cam_from_world, seen)
    landmarks = (rays(KEYPOINT_SCALE, table=BODY_25 | FACE, face=FACE_WEIGHT),)
    images = [capture.image(c, frame) for c in views]
    masks = [capture.mask(c, frame) for c in views]
    if surface is None:
        surface = surface_of(character, None, cameras.num_cameras)
    rectangle = frame_rectangle(
        np.asarray(skin(character, pose)), cameras, frame, speed=np.full(cameras.num_cameras, 30.0)
    )
    cropped = [None if m is None else rectangle.crop(m, c) for c, m in enumerate(masks)]
    masked = any(m is not None for m in cropped)
    edges = None
    if masked:
        edges = [
            image_edges(rectangle.crop(image, camera)) if mask is None else mask_edges(mask)
            for camera, (image, mask) in enumerate(zip(images, cropped, strict=True))
        ]
    problem = build_problem(images, rectangle, cameras, frame, np.asarray(skin(character, pose)), surface, edges=edges)
    pose = fit_to_masks(character, pose, problem, landmarks, settings, fixed, masked)
    searched = False
    agreement = _agreement(character, pose, problem, cropped)
    if np.nanmin(np.append(agreement, 1.0)) < settings.search_below:
        searched = all(m is not None for m in cropped)
        if searched:
            solid = jnp.asarray(np.stack([m for m in cropped if m is not None]), jnp.float32)
            found = search_silhouettes(character, pose, problem, solid, key, fixed)
            found = fit_to_masks(character, found, problem, landmarks, settings, fixed)
            better = _agreement(character, found, problem, cropped)
            if np.nanmean(better) > np.nanmean(agreement):
                pose, agreement = found, better
    if settings.view_flow and cameras.num_cameras > 1:
        crops = [rectangle.crop(image, c) for c, image in enumerate(images)]
        pose = fit_between_views(character, pose, problem, crops, landmarks, settings, fixed, masked)
        agreement = _agreement(character, pose, problem, cropped)
    return Registration(frame, pose, agreement, keypoint_distance(character.skeleton, pose, rays()), searched)


def _agreement(
    character: Character, pose: Pose, problem: FrameProblem, masks: list[Bool[np.ndarray, "height width"] | None]
) -> Float[np.ndarray, "camera"]:
    _, ids, _ = draw(character, pose, problem)
    drawn = np.asarray(ids) >= 0
    return np.array([np.nan if m is None else intersection_over_union(drawn[c], m) for c, m in enumerate(masks)])


def register(
    capture: Capture,
    cameras: Cameras,
    character: Character,
    frames: tuple[int, ...] | None = None,
    *,
    key: PRNGKeyArray | None = None,
    overrides: Overrides | None = None,
    start: Pose | None = None,
    settings: RegistrationSettings | None = None,
    progress: Callable[[str, int, int], None] | None = None,
) -> dict[int, Registration]:
    """Register the mesh at the selected frames of a capture (Gamma), chosen if it names none, or at `frames`.

    Returns the poses by frame, positions in the span that all cameras share. `overrides` fixes degrees of freedom,
    frame -> name -> metres or degrees, as `read_pose_file` returns them. `start` takes the place of the pose that the
    keypoints tell, at every frame. `key` is for the search that follows where the outlines do not fit. Frames are
    registered side by side, one per core; `progress` hears "register", how many are done, and of how many.
    Raises `InputError` when the keypoints and the cameras cannot both be right (another unit, mirrored cameras).
    """
    key = jax.random.key(0) if key is None else key
    check_key(key)
    if frames is None:
        frames = capture.selected_frames or choose_frames(capture, cameras).frames
    for values in (overrides or {}).values():  # a wrong name is told before the long work
        apply_overrides(character, rest_pose(character.skeleton), values)
    if start is None:
        for finding in check_subject(capture, cameras, frames):
            if finding.severity == "error":
                raise InputError(f"capture '{capture.name}': {finding.message}")
    character = filled_up(character)
    surface = surface_of(character, None, cameras.num_cameras)

    def one(frame: int) -> Registration:
        return register_frame(
            capture,
            cameras,
            character,
            frame,
            key=jax.random.fold_in(key, frame),
            surface=surface,
            start=start,
            overrides=(overrides or {}).get(frame),
            settings=settings,
        )

    tell = progress or (lambda stage, done, total: None)
    tell("register", 0, len(frames))
    found: dict[int, Registration] = {}
    for frame, registration in zip(frames, side_by_side(one, frames), strict=True):
        found[frame] = registration
        tell("register", len(found), len(frames))
    return found
