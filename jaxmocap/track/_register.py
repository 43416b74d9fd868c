"""Registration of the mesh at the selected frames (sec. 3.2): keypoints, then contours and masks, then search if
needed."""

import json
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, PRNGKeyArray

from jaxmocap._results import InputError
from jaxmocap.camera import Cameras
from jaxmocap.capture import Capture, check_subject, choose_frames
from jaxmocap.character import Character, Pose, pose_from_vector, pose_vector, rest_pose, retract, skin
from jaxmocap.energies import (
    ContourSettings,
    LandmarkRays,
    SearchEnergy,
    Silhouette,
    contour_lines,
    keypoint_rays,
)
from jaxmocap.observation import (
    FrameProblem,
    Rectangle,
    Surface,
    build_problem,
    mask_edges,
    place_rectangle,
    projected_box,
    stacked_keypoints,
    surface_of,
)
from jaxmocap.refiners import AbstractRefiner, Shooting
from jaxmocap.render import face_ids
from jaxmocap.samplers import InteractingSimulatedAnnealing, particles_for

from ._inverse_kinematics import inverse_kinematics
from ._least_squares import Prior, Rows, descend, free_prior
from ._search import Stage, group_searches, initial_spread
from ._surface_flow import FlowSettings, Source, same_time_sources, surface_flow


@dataclass(frozen=True)
class RegistrationSettings:
    """`rounds` of contour association and least squares. Below `search_below` intersection over union the silhouette
    energy is searched by annealing (Gall et al. 2009). `view_flow` rounds compare the views with each other through the
    surface (Eq. 7 as least squares); 0 leaves that out, which is the paper's registration."""

    rounds: int = 10
    search_below: float = 0.9
    warn_below: float = 0.9
    view_flow: int = 10
    refiner: AbstractRefiner = field(default_factory=Shooting)


@dataclass(frozen=True)
class Registration:
    """The pose at one selected frame, and how well it fits: intersection over union per view (NaN without a mask), RMS
    distance to the keypoints' rays in metres, and whether annealing was needed."""

    frame: int
    pose: Pose
    iou: Float[np.ndarray, "camera"]
    keypoint_rms: float
    searched: bool


LARGEST_VALUE = 1e6
"""No metre or degree of a pose file is larger."""

Overrides = dict[int, dict[str, float]]
"""Frame -> DoF name -> value: metres for root translations, degrees for everything else."""


def apply_overrides(character: Character, pose: Pose, values: dict[str, float]) -> tuple[Pose, list[int]]:
    """The pose with single DoFs set, and their indices. Raises `InputError` for a name the skeleton does not have."""
    skeleton = character.skeleton
    vector = np.array(pose_vector(skeleton, pose))
    indices = []
    for name, value in values.items():
        if name not in skeleton.dof_names:
            raise InputError(
                f"the pose file sets '{name}', which is no degree of freedom; the names are "
                f"{', '.join(skeleton.dof_names)}."
            )
        index = skeleton.dof_names.index(name)
        vector[index] = value if index < 3 else np.deg2rad(value)
        if index >= 6:
            low, high = float(skeleton.lower[index - 6]), float(skeleton.upper[index - 6])
            if not low - 1e-6 <= vector[index] <= high + 1e-6:
                raise InputError(
                    f"the pose file sets {name} = {value:g} degrees, outside its limits "
                    f"{np.rad2deg(low):.0f} to {np.rad2deg(high):.0f}."
                )
        indices.append(index)
    return pose_from_vector(skeleton, jnp.asarray(vector, jnp.float32)), indices


def read_pose_file(path: str | Path) -> Overrides:
    """Overrides from a JSON file: `{"0": {"root_ty": 0.1, "l_elbow_flex": 30}}`, frame -> DoF -> metres or degrees.

    Raises `InputError` for anything else.
    """
    try:
        raw = json.loads(Path(path).read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"the pose file {path} cannot be read as JSON ({error}).") from error
    expected = f'the pose file {path} must map frames to degrees of freedom, like {{"0": {{"l_elbow_flex": 30}}}}'
    if not isinstance(raw, dict):
        raise InputError(f"{expected}; its top level is {type(raw).__name__}.")
    overrides: Overrides = {}
    for frame, values in raw.items():
        if not (frame.isascii() and frame.isdigit() and len(frame) < 10) or not isinstance(values, dict):
            raise InputError(f"{expected}; found the entry {frame[:40]!r}.")
        for name, value in values.items():
            if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= LARGEST_VALUE:
                raise InputError(
                    f"the pose file {path} gives {name} at frame {frame} the value "
                    f"{repr(value)[:40]}; a number is expected."
                )
        overrides[int(frame)] = {name: float(value) for name, value in values.items()}
    return overrides


def intersection_over_union(ids: np.ndarray, mask: Bool[np.ndarray, "height width"]) -> float:
    """Agreement of a drawn mesh (face ids, -1 empty) and a mask."""
    drawn = np.asarray(ids) >= 0
    union = (drawn | mask).sum()
    return float((drawn & mask).sum() / union) if union else float("nan")


def frame_rectangle(
    vertices: np.ndarray,
    cameras: Cameras,
    frame: int,
    previous: Rectangle | None = None,
    speed: np.ndarray | None = None,
) -> Rectangle:
    """The rectangle around a posed mesh in every view."""
    view = cameras.at(frame)
    intrinsics, cam_from_world = np.asarray(view.intrinsics), np.asarray(view.cam_from_world)
    boxes = []
    for camera, name in enumerate(cameras.names):
        box = projected_box(vertices, intrinsics[camera], cam_from_world[camera])
        if box is None:
            raise InputError(
                f"the person lies behind camera '{name}' at frame {frame}; check the cameras and the keypoints."
            )
        boxes.append(box)
    still = np.zeros(cameras.num_cameras) if speed is None else speed
    return place_rectangle(np.stack(boxes), still, cameras.sizes, previous, cameras.names)


def draw(character: Character, pose: Pose, problem: FrameProblem) -> tuple[Array, Array, Array]:
    """Posed vertices, face ids and inverse depth in the rectangle."""
    vertices = skin(character, pose)
    height, width = problem.size
    ids, inverse = face_ids(
        vertices, character.faces, problem.intrinsics, problem.cam_from_world, problem.origins, height, width
    )
    return vertices, ids, inverse


def _frozen(prior: Prior, fixed: list[int]) -> Prior:
    """The prior with some DoFs held at the base pose."""
    index = jnp.array(fixed, jnp.int32)
    return prior._replace(lower=prior.lower.at[index].set(0.0), upper=prior.upper.at[index].set(0.0))


def _mask_contours(within: float) -> ContourSettings:
    """How contours look for a mask's outline, no farther than so many pixels; one compiled program for all of them."""
    return ContourSettings(reach=30, capacity=2048, accept_cosine=0.5, accept_score=0.8, within=within)


def fit_to_masks(
    character: Character,
    pose: Pose,
    problem: FrameProblem,
    landmarks: tuple[LandmarkRays, ...],
    settings: RegistrationSettings,
    fixed: list[int],
) -> Pose:
    """Local optimisation of Gall et al. 2009: contour points to the mask outline, re-associated every round."""
    for round_index in range(settings.rounds):
        contours = _mask_contours(30 if round_index < 3 else 15)
        vertices, ids, inverse = draw(character, pose, problem)
        lines = contour_lines(vertices, character.faces, ids, inverse, problem, contours)
        prior = free_prior(character, pose, np.repeat(np.array([0.5, 3.0], np.float32), [6, 33]))
        rows = (Rows(lines, 0.02, 0.03 if round_index < 5 else 0.015),)
        delta, _ = descend(
            character,
            pose,
            jnp.zeros(39),
            rows,
            landmarks,
            _frozen(prior, fixed),
            settings.refiner,
            steps=3,
            damping=1e-3,
        )
        pose = retract(character.skeleton, pose, delta)
    return pose


def search_silhouettes(
    character: Character,
    pose: Pose,
    problem: FrameProblem,
    masks: Float[Array, "camera height width"],
    key: PRNGKeyArray,
    fixed: list[int],
) -> Pose:
    """Annealing on the silhouette energy, group by group."""
    energy = SearchEnergy((Silhouette(masks),))
    spread = initial_spread(character) * 1.5
    spread[fixed] = 0.0
    for number, search in enumerate(group_searches(character)):
        sampler = InteractingSimulatedAnnealing(num_particles=particles_for(len(search.dofs)), num_iterations=15)
        result = search(
            (Stage(energy, 1, 15),), sampler, character, pose, problem, spread, jax.random.fold_in(key, number)
        )
        pose = retract(character.skeleton, pose, result.increment)
    return pose


def fit_between_views(
    character: Character,
    pose: Pose,
    problem: FrameProblem,
    crops: list[np.ndarray],
    landmarks: tuple[LandmarkRays, ...],
    settings: RegistrationSettings,
    fixed: list[int],
    extra: list[list[Source]] | None = None,
) -> Pose:
    """Contours to the masks and, through the surface, every view against every other (and `extra` sources)."""
    cameras = range(problem.num_cameras)
    for _ in range(settings.view_flow):
        vertices, ids, inverse = draw(character, pose, problem)
        host_ids = np.asarray(ids)
        pictures = [_embed(crop, origin) for crop, origin in zip(crops, np.asarray(problem.origins), strict=True)]
        views = same_time_sources(pictures, problem, vertices, host_ids)
        sources = [[views[n] for n in cameras if n != m] + (extra[m] if extra else []) for m in cameras]
        flows = surface_flow(character, vertices, ids, crops, problem, sources, FlowSettings())
        contours = contour_lines(vertices, character.faces, ids, inverse, problem, _mask_contours(12))
        rows = (Rows(contours, 0.02, 0.012), *(Rows(lines, 0.02, 0.015) for lines in flows))
        prior = free_prior(character, pose, np.repeat(np.array([0.2, 0.8], np.float32), [6, 33]))
        delta, _ = descend(
            character,
            pose,
            jnp.zeros(39),
            rows,
            landmarks,
            _frozen(prior, fixed),
            settings.refiner,
            steps=3,
            damping=1e-3,
        )
        pose = retract(character.skeleton, pose, delta)
    return pose


def _embed(crop: np.ndarray, origin: np.ndarray) -> np.ndarray:
    """The crop at its place in a full image, so that source pixels keep full-image coordinates."""
    return cv2.copyMakeBorder(crop, int(origin[0]), 0, int(origin[1]), 0, cv2.BORDER_REPLICATE)


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
    """Pose of the mesh at one selected frame.

    `start` replaces the inverse kinematics (needed when the frame has no keypoints). `overrides` fixes single DoFs.
    """
    settings = RegistrationSettings() if settings is None else settings
    views = range(cameras.num_cameras)
    view = cameras.at(frame)
    keypoints = [capture.keypoints(c, frame) for c in views]
    rms = float("nan")
    if start is None and all(points is None for points in keypoints):
        if not overrides:
            name = f"{capture.camera_names[0]}_{int(capture.video_frames[0, frame]):05d}_keypoints.json"
            raise InputError(
                f"frame {frame} of capture '{capture.name}' has no keypoints and no initial pose; add keypoints of "
                f"this frame, best in two cameras ({name} and so on), or give its pose with --pose."
            )
        start = rest_pose(character.skeleton)
    if start is None:
        pose, rms = inverse_kinematics(
            character, view, keypoints, settings.refiner, where=f"frame {frame} of capture '{capture.name}'"
        )
    else:
        pose = start
    fixed: list[int] = []
    if overrides:
        pose, fixed = apply_overrides(character, pose, overrides)
    seen = jnp.asarray(stacked_keypoints(keypoints))
    landmarks = (keypoint_rays(character.skeleton, view.intrinsics, view.cam_from_world, seen, scale=0.08),)
    images = [capture.image(c, frame) for c in views]
    masks = [capture.mask(c, frame) for c in views]
    if surface is None:
        surface = surface_of(character, None, cameras.num_cameras)
    rectangle = frame_rectangle(
        np.asarray(skin(character, pose)), cameras, frame, speed=np.full(cameras.num_cameras, 30.0)
    )
    cropped = [None if m is None else rectangle.crop(m, c) for c, m in enumerate(masks)]
    edges = [mask_edges(m) if m is not None else None for m in cropped]
    problem = build_problem(images, rectangle, cameras, frame, np.asarray(skin(character, pose)), surface)
    if any(e is not None for e in edges):
        known = [
            e if e is not None else (np.asarray(problem.edges.mask[c]), np.asarray(problem.edges.gradient[c]))
            for c, e in enumerate(edges)
        ]
        problem = build_problem(
            images, rectangle, cameras, frame, np.asarray(skin(character, pose)), surface, edges=known
        )
    pose = fit_to_masks(character, pose, problem, landmarks, settings, fixed)
    searched = False
    agreement = _agreement(character, pose, problem, cropped)
    if np.nanmin(np.append(agreement, 1.0)) < settings.search_below:
        searched = True
        solid = jnp.asarray(np.stack([m if m is not None else np.zeros(problem.size) for m in cropped]), jnp.float32)
        if all(m is not None for m in cropped):
            found = search_silhouettes(character, pose, problem, solid, key, fixed)
            found = fit_to_masks(character, found, problem, landmarks, settings, fixed)
            better = _agreement(character, found, problem, cropped)
            if np.nanmean(better) > np.nanmean(agreement):
                pose, agreement = found, better
    if settings.view_flow and cameras.num_cameras > 1:
        crops = [rectangle.crop(image, c) for c, image in enumerate(images)]
        pose = fit_between_views(character, pose, problem, crops, landmarks, settings, fixed)
        agreement = _agreement(character, pose, problem, cropped)
    return Registration(frame, pose, agreement, rms, searched)


def _agreement(character, pose, problem, masks) -> Float[np.ndarray, "camera"]:
    _, ids, _ = draw(character, pose, problem)
    host = np.asarray(ids)
    return np.array([intersection_over_union(host[c], m) if m is not None else np.nan for c, m in enumerate(masks)])


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
) -> dict[int, Registration]:
    """Register the mesh at the selected frames of a capture (Gamma), chosen if it names none, or at `frames`.

    Raises `InputError` when the keypoints and the cameras cannot both be right (another unit, mirrored cameras).
    """
    key = jax.random.key(0) if key is None else key
    if frames is None:
        frames = capture.selected_frames or choose_frames(capture, cameras).frames
    if start is None:
        for finding in check_subject(capture, cameras):
            if finding.severity == "error":
                raise InputError(f"capture '{capture.name}': {finding.message}")
    surface = surface_of(character, None, cameras.num_cameras)
    return {
        frame: register_frame(
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
        for frame in frames
    }
