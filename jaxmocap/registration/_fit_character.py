"""A generic character made to the measure of the filmed person, from keypoints and masks of a few frames."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxmocap._results import InputError
from jaxmocap._runtime import side_by_side
from jaxmocap.camera import Cameras
from jaxmocap.capture import Capture, check_subject
from jaxmocap.character import BodyShape, Character, Pose, clamp, scaled, stature
from jaxmocap.energies import LandmarkRays, keypoint_rays
from jaxmocap.observation import BODY_25, FACE, stacked_keypoints

from ._character_fit import CharacterFit, CharacterFitSettings
from ._fit_surface import fit_surface
from ._inverse_kinematics import inverse_kinematics, triangulated
from ._shape_outlines import mask_problems, outlines
from ._shape_problem import OFFSETS, FramesSeen, ShapeProblem, detector_points, solve

FEWEST_FRAMES, FEWEST_POINTS = 3, 3
FEWEST_VIEWS = 8
"""Views of one moment that tell as much of a person's proportions as two or three of several moments do."""

_POINTS = BODY_25 | FACE
_T = TypeVar("_T")


def fit_character(
    capture: Capture,
    cameras: Cameras,
    character: Character,
    frames: Sequence[int] | None = None,
    *,
    height: float | None = None,
    start: Mapping[int, Pose] | None = None,
    settings: CharacterFitSettings | None = None,
    progress: Callable[[str, int, int], None] | None = None,
) -> CharacterFit:
    """Fit bone lengths and girths of a generic character to a capture's keypoints and masks at a few frames.

    Not in the paper, which scans its actors. `frames` are positions, by default the selected frames, and need BODY_25
    keypoints in two views; girths are learnt from masks where there are any and else follow the lengths. All
    unknowns, `BodyShape`, detector offsets and one pose per frame, are solved together by Levenberg-Marquardt
    (optimistix) with the priors of `ShapePrior`; keypoints weigh by confidence. Masks then shape the surface where
    lengths and girths leave it off their outlines (`SurfaceSettings`). `height` is how tall the person is, in
    metres, where that is known: the generic character is scaled to it, and the fitted one keeps it to a per cent
    (`CharacterFit.height`).
    `start` are poses to begin with, by frame, such as those of an earlier fit; others are found. Raises `InputError`
    when fewer than three frames can be used, for the proportions would be guesses, and where `register` does; one frame
    will do that eight views show, as the pictures of a scan.
    """
    settings = CharacterFitSettings() if settings is None else settings
    tell = progress or (lambda stage, done, total: None)
    asked = tuple(sorted(set(capture.selected_frames or () if frames is None else frames)))
    chosen = usable_frames(capture, cameras, asked)
    having = [name for camera, name in enumerate(capture.camera_names) if capture.keypoint_frames(camera)]
    enough = measurable(capture, chosen)
    if not enough and len(having) == 1:
        raise InputError(
            f"capture '{capture.name}': only '{having[0]}' has keypoints, and one view cannot be measured; add "
            f"keypoints of another camera (jaxmocap detect {capture.folder}), or make a body of a height that you say: "
            "jaxmocap body --out body.glb --height 1.75."
        )
    if not enough:
        listed = f" ({', '.join(map(str, asked))})" if asked else ""
        raise InputError(
            f"capture '{capture.name}': {len(chosen)} of the {len(asked)} frames to fit at{listed} have "
            f"{FEWEST_POINTS} or more keypoints in two views, but fitting a character needs {FEWEST_FRAMES} such "
            "frames; add keypoint files, or choose other frames with --at."
        )
    for finding in check_subject(capture, cameras, chosen):
        if finding.severity == "error":
            raise InputError(f"capture '{capture.name}': {finding.message}")
    generic, grown = character, 0.0
    if height is not None:
        grown = float(np.log(height / stature(generic)))
        character = scaled(generic, BodyShape.of(grown))

    def first_pose(frame: int) -> Pose:
        if start is not None and frame in start:
            return start[frame]
        where = f"frame {frame} of capture '{capture.name}'"
        keypoints = _keypoints(capture, frame)
        return inverse_kinematics(character, cameras.at(frame), keypoints, settings.pose_refiner, where=where)[0]

    base, rays = [], []
    tell("poses", 0, len(chosen))
    for frame, pose in zip(chosen, side_by_side(first_pose, chosen), strict=True):
        view, seen = cameras.at(frame), jnp.asarray(stacked_keypoints(_keypoints(capture, frame)))
        scale = settings.keypoint_scale
        base.append(pose)
        rays.append(keypoint_rays(character.skeleton, view.intrinsics, view.cam_from_world, seen, scale, table=_POINTS))
        tell("poses", len(base), len(chosen))
    measured = None if height is None else jnp.asarray(height, jnp.float32)
    problem = ShapeProblem(character, FramesSeen(_stacked(base), _stacked(rays)), settings.prior, measured)
    masks = [[capture.mask(c, frame) for c in range(cameras.num_cameras)] for frame in chosen]
    num_masks = sum(mask is not None for row in masks for mask in row)
    rounds = settings.mask_rounds + (settings.surface is not None) if num_masks else 0
    stages = len(settings.robust) + rounds
    vector = problem.start()
    for number, robust in enumerate(settings.robust):
        tell("shape", number, stages)
        fading = jnp.full(len(chosen), robust)
        problem = eqx.tree_at(lambda p: p.seen.rays.robust, problem, fading)
        vector = solve(problem, vector, settings.refiner)
    if num_masks:
        outlined = tuple(i for i, row in enumerate(masks) if any(mask is not None for mask in row))
        shown = lambda poses: [poses[i] for i in outlined]  # noqa: E731
        fitted, poses = _found(problem, vector)
        posed = dict(zip(shown(chosen), shown(poses), strict=True))
        views = mask_problems(capture, cameras, character, posed, shown(masks))
        beside = jnp.full(len(chosen), settings.keypoint_scale_beside_masks)
        problem = eqx.tree_at(lambda p: p.seen.rays.scale, problem, beside)
        for number in range(settings.mask_rounds):
            tell("shape", len(settings.robust) + number, stages)
            contours = outlines(fitted, shown(poses), views, number)
            problem = replace(problem, seen=FramesSeen(problem.seen.base, problem.seen.rays, contours, outlined))
            vector = solve(problem, vector, settings.mask_refiner)
            fitted, poses = _found(problem, vector)
    fitted, poses = _found(problem, vector)
    tall, surface = float(stature(fitted)), None
    if num_masks and settings.surface is not None:
        tell("shape", stages - 1, stages)
        moved = fit_surface(fitted, dict(zip(shown(chosen), shown(poses), strict=True)), views, settings.surface)
        fitted, surface = moved.character, moved.offsets
        poses = [moved.poses.get(frame, pose) for frame, pose in zip(chosen, poses, strict=True)]
    tell("shape", stages, stages)
    found = problem.unknowns(vector)
    shape = BodyShape(found.shape.height + grown, found.shape.lengths, found.shape.girths)
    return CharacterFit(
        character=replace(fitted, misfit=settings.misfit),
        height=tall,
        shape=shape,
        poses=dict(zip(chosen, poses, strict=True)),
        offsets=dict(zip(OFFSETS, np.asarray(found.offsets), strict=True)),
        keypoint_error=_error(fitted, poses, rays, found.offsets),
        generic_error=_error(character, base, rays, jnp.zeros_like(found.offsets)),
        num_masks=num_masks,
        surface=surface,
    )


def _keypoints(capture: Capture, frame: int) -> list[np.ndarray | None]:
    return [capture.keypoints(camera, frame) for camera in range(capture.num_cameras)]


def measurable(capture: Capture, frames: Sequence[int]) -> bool:
    """Tell whether usable frames are enough to fit a character: three, or one with keypoints in eight views."""
    seen = (sum(points is not None for points in _keypoints(capture, frame)) for frame in frames)
    return len(frames) >= FEWEST_FRAMES or any(views >= FEWEST_VIEWS for views in seen)


def usable_frames(capture: Capture, cameras: Cameras, frames: Sequence[int]) -> tuple[int, ...]:
    """Choose those of the frames in which two views show enough keypoints to fit a character."""
    beyond = [frame for frame in frames if not 0 <= frame < capture.num_frames]
    if beyond:
        raise InputError(
            f"capture '{capture.name}' has no frame {beyond[0]}; its frames are 0 to {capture.num_frames - 1}."
        )
    usable = []
    for frame in frames:
        keypoints = _keypoints(capture, frame)
        if sum(points is not None for points in keypoints) >= 2:
            _, known = triangulated(cameras.at(frame), keypoints)
            usable += [frame] * bool(known.sum() >= FEWEST_POINTS)
    return tuple(usable)


def _stacked(values: list[_T]) -> _T:
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *values)


def _found(problem: ShapeProblem, vector: Float[Array, "unknown"]) -> tuple[Character, list[Pose]]:
    """Return the character of a solution and its poses."""
    unknowns = problem.unknowns(vector)
    fitted = scaled(problem.character, unknowns.shape)
    poses = problem.poses(unknowns, fitted)
    return fitted, [clamp(fitted.skeleton, Pose(*pose)) for pose in zip(poses.root, poses.angles, strict=True)]


def _error(character: Character, poses: list[Pose], rays: list[LandmarkRays], offsets: Array) -> float:
    distances = []
    for pose, lines in zip(poses, rays, strict=True):
        vectors = lines.distances(detector_points(character.skeleton, pose, offsets))
        distances.append(np.linalg.norm(np.asarray(vectors), axis=1)[np.asarray(lines.weight) > 0])
    return float(np.median(np.concatenate(distances)))
