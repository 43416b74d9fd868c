"""Fit a posed mesh to the masks of one frame: contours, silhouettes, and views against each other."""

from dataclasses import dataclass, field, replace

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from jaxmocap.camera import view_angles
from jaxmocap.character import Character, Pose, retract, skin
from jaxmocap.energies import ContourSettings, LandmarkRays, SearchEnergy, Silhouette, contour_lines
from jaxmocap.observation import FrameProblem, draw
from jaxmocap.refinement import FlowSettings, Rows, current_views, descend, free_prior, surface_flow
from jaxmocap.refiners import AbstractRefiner, Shooting
from jaxmocap.samplers import InteractingSimulatedAnnealing, particles_for
from jaxmocap.search import group_searches

NEAREST = 4
"""Other views that a view is held against, those nearest in direction: from farther off the surface looks otherwise."""

STRETCH = 2.0
"""Factor on the steps of `fit_between_views`: flow between pictures that are nearly alike tells too little of what is
left, and steps of this length need half as many rounds (at 3 they overshoot)."""

_MOST_ROWS = 16_000
"""Rows of surface flow in one least squares, all pairs of views together; where there are many, each has fewer."""


@dataclass(frozen=True)
class RegistrationSettings:
    """How a rough pose becomes a registered one (sec. 3.2).

    Attributes:
        rounds: of contour association and least squares.
        search_below: intersection over union below which the silhouette energy is searched by annealing (Gall et al.
            2009).
        warn_below: intersection over union below which the command line warns.
        view_flow: rounds that compare the views with each other through the surface (Eq. 7 as least squares); 20,
            ours; 0, the paper, leaves that out.
        refiner: solves the least squares.
    """

    rounds: int = 10
    search_below: float = 0.9
    warn_below: float = 0.9
    view_flow: int = 20
    refiner: AbstractRefiner = field(default_factory=Shooting)


def moved_by_rows(
    character: Character,
    pose: Pose,
    rows: tuple[Rows, ...],
    landmarks: tuple[LandmarkRays, ...],
    weight: Float[np.ndarray, "dof"],
    settings: RegistrationSettings,
    fixed: list[int],
    stretch: float = 1.0,
) -> Pose:
    """Move the pose by three steps of least squares, stretched; `weight` pulls it back and the DoFs `fixed` stay."""
    prior, index = free_prior(character, pose, weight), jnp.array(fixed, jnp.int32)
    prior = prior._replace(lower=prior.lower.at[index].set(0.0), upper=prior.upper.at[index].set(0.0))
    still = jnp.zeros(character.skeleton.num_dofs)
    delta, _ = descend(character, pose, still, rows, landmarks, prior, settings.refiner, steps=3)
    return retract(character.skeleton, pose, jnp.clip(stretch * delta, prior.lower, prior.upper))


def mask_contours(within: float, masked: bool = True) -> ContourSettings:
    """Say how contours look for the outline of a mask (or, not `masked`, for edges of the picture), no farther than so
    many pixels; one compiled program for all distances."""
    return ContourSettings(reach=30, capacity=2048, inside=masked, accept_cosine=0.5, accept_score=0.8, within=within)


def fit_to_masks(
    character: Character,
    pose: Pose,
    problem: FrameProblem,
    landmarks: tuple[LandmarkRays, ...],
    settings: RegistrationSettings,
    fixed: list[int],
    masked: bool = True,
) -> Pose:
    """Fit contour points to the mask outline, re-associated every round: the local optimisation of Gall et al. 2009.

    Where it is not `masked`, the problem's edges are those of its pictures.
    """
    weight = character.skeleton.per_dof(root=0.5, angles=3.0)
    for round_index in range(settings.rounds):
        contours = mask_contours(30 if round_index < 3 else 15, masked)
        vertices, ids, inverse = draw(character, pose, problem)
        lines = contour_lines(vertices, character.faces, ids, inverse, problem, contours)
        rows = (Rows(lines, 0.02, 0.03 if round_index < 5 else 0.015),)
        pose = moved_by_rows(character, pose, rows, landmarks, weight, settings, fixed)
    return pose


def search_silhouettes(
    character: Character,
    pose: Pose,
    problem: FrameProblem,
    masks: Float[Array, "camera height width"],
    key: PRNGKeyArray,
    fixed: list[int],
) -> Pose:
    """Anneal on the silhouette energy, group by group."""
    energy = SearchEnergy((Silhouette(masks=masks),))
    spread = character.skeleton.initial_spread * 1.5
    spread[fixed] = 0.0
    for number, search in enumerate(group_searches(character, energy)):
        sampler = InteractingSimulatedAnnealing(num_particles=particles_for(len(search.dofs)), num_iterations=15)
        result = search(sampler, pose, problem, spread, jax.random.fold_in(key, number))
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
    masked: bool = True,
) -> Pose:
    """Fit contours to the masks and, over the surface, every view to the `NEAREST` others."""
    weight = character.skeleton.per_dof(root=0.2, angles=0.8)
    near = _nearest_views(np.asarray(problem.cam_from_world), np.asarray(skin(character, pose)).mean(0))
    flow = FlowSettings()
    flow = replace(flow, samples=min(flow.samples, _MOST_ROWS // max(sum(map(len, near)), 1)))
    for _ in range(settings.view_flow):
        vertices, ids, inverse = draw(character, pose, problem)
        views = current_views(crops, problem, vertices, ids)
        sources = [[views[n] for n in others] for others in near]
        flows = surface_flow(character.faces, problem.surface.near_faces, views, sources, flow)
        contours = contour_lines(vertices, character.faces, ids, inverse, problem, mask_contours(12, masked))
        rows = (Rows(contours, 0.02, 0.012), *(Rows(lines, 0.02, 0.015) for lines in flows))
        pose = moved_by_rows(character, pose, rows, landmarks, weight, settings, fixed, STRETCH)
    return pose


def _nearest_views(cam_from_world: Float[np.ndarray, "camera 4 4"], point: Float[np.ndarray, "3"]) -> list[list[int]]:
    """List of every camera the `NEAREST` others by direction, seen from a point; in the order of the cameras."""
    order = np.argsort(view_angles(cam_from_world, point), axis=1, kind="stable")
    return [sorted([int(n) for n in row if n != camera][:NEAREST]) for camera, row in enumerate(order)]
