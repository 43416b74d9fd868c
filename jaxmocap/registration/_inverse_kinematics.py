"""A rough pose from 2D keypoints: inverse kinematics."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxmocap._cache import cached_jit
from jaxmocap._results import InputError
from jaxmocap.camera import View, triangulate
from jaxmocap.character import (
    ROOT_DOFS,
    Character,
    Pose,
    Skeleton,
    clamp,
    landmark_positions,
    pose_from_vector,
    retract,
)
from jaxmocap.energies import LandmarkRays, keypoint_rays
from jaxmocap.observation import stacked_keypoints
from jaxmocap.refiners import AbstractRefiner, RefineProblem

from ._single_view import LEAST_POINTS, TRUNK, best_view, body_axes, rest_trunk, single_view_starts

LIMB_STARTS = 12
AT_ONCE = 6
"""Starts that one call of the compiled program solves, one after the other, so that many and few share it."""


def triangulated(
    view: View, keypoints: list[Float[np.ndarray, "25 3"] | None]
) -> tuple[Float[np.ndarray, "25 3"], np.ndarray]:
    """Triangulate keypoints seen in two or more views: world positions, and which these are."""
    pixels = np.stack([k[:, :2] if k is not None else np.zeros((25, 2)) for k in keypoints])
    weights = np.stack([k[:, 2] if k is not None else np.zeros(25) for k in keypoints])
    known = (weights > 0).sum(0) >= 2
    points = np.asarray(triangulate(view, jnp.asarray(pixels, jnp.float32), jnp.asarray(weights, jnp.float32)))
    return points, known & np.isfinite(points).all(1)


def _starts(
    character: Character,
    view: View,
    keypoints: list[Float[np.ndarray, "25 3"] | None],
    where: str,
) -> list[Pose]:
    """Bodies at rest where the person may stand: in the axes of the triangulated trunk; else about the triangulated
    points, turned to eight sides; else, where two views share less than three points, by the best single view."""
    points, known = triangulated(view, keypoints)
    skeleton = character.skeleton
    if known.sum() < 3:
        camera = best_view(keypoints)
        found = None if camera is None else keypoints[camera]
        if camera is None or found is None:
            raise InputError(
                f"{where or 'the keypoints'}: {int(known.sum())} keypoints are seen by two cameras, three are needed "
                f"to place the person, or shoulders, hips and {LEAST_POINTS} points in all in one; add keypoints for "
                "this frame in a second camera, or give the pose with --pose."
            )
        return single_view_starts(character, view, camera, found)
    if known[list(TRUNK)].all():
        rest_axes, rest_hips = rest_trunk(skeleton)
        right_shoulder, left_shoulder, right_hip, left_hip = points[list(TRUNK)]
        rotation = body_axes(left_shoulder, right_shoulder, left_hip, right_hip) @ rest_axes.T
        root = np.eye(4, dtype=np.float32)
        root[:3, :3], root[:3, 3] = rotation, 0.5 * (left_hip + right_hip) - rotation @ rest_hips
        return [Pose(jnp.asarray(root), jnp.zeros(skeleton.num_angles))]
    centre, turned = points[known].mean(0) - np.asarray(skeleton.landmarks).mean(0), []
    for yaw in np.linspace(0, 2 * np.pi, 8, endpoint=False):
        vector = jnp.zeros(skeleton.num_dofs).at[:3].set(jnp.asarray(centre, jnp.float32)).at[4].set(yaw)
        turned.append(pose_from_vector(skeleton, vector))
    return turned


def inverse_kinematics(
    character: Character,
    view: View,
    keypoints: list[Float[np.ndarray, "25 3"] | None],
    refiner: AbstractRefiner,
    starts: int = 48,
    where: str = "",
) -> tuple[Pose, float]:
    """Pose whose landmarks lie on the keypoints' rays, joint limits kept: the paper's "rough registered skeleton".

    Least squares from `starts` starts (the trunk's root with other joint angles each); then every limb of the best one
    starts anew from `LIMB_STARTS` places within its limits, for one limb of many is easily folded wrongly. Returned
    with its RMS distance to the rays in metres. One view is enough if it shows shoulders, hips and `LEAST_POINTS`
    points in all, but leaves open which way limbs point in depth. Raises `InputError` when the points are too few.
    """
    skeleton, points_seen = character.skeleton, jnp.asarray(stacked_keypoints(keypoints))
    bases = _starts(character, view, keypoints, where)
    lines = keypoint_rays(skeleton, view.intrinsics, view.cam_from_world, points_seen)
    generator = np.random.default_rng(0)
    best: tuple[float, Pose, Array] | None = None
    per_base = max(2, starts // len(bases))
    for base in bases:
        size = (per_base, skeleton.num_angles)
        shares = generator.uniform(0.05, 0.5, size) * generator.integers(0, 2, size)
        shares[0] = 0
        side = np.where(generator.random(size) < 0.7, np.asarray(skeleton.upper), np.asarray(skeleton.lower))
        start = jnp.concatenate([jnp.zeros((per_base, ROOT_DOFS)), jnp.asarray(shares * side, jnp.float32)], -1)
        cost, delta = _best_of(character, base, lines, refiner, start)
        if best is None or cost < best[0]:
            best = (cost, base, delta)
    assert best is not None
    cost, base, delta = best
    lower, upper = (np.asarray(limit) - np.asarray(base.angles) for limit in (skeleton.lower, skeleton.upper))
    for dofs in (np.array(skeleton.group(limb)) for limb in skeleton.limbs):
        start = np.tile(np.asarray(delta), (LIMB_STARTS, 1))
        start[:, dofs] = generator.uniform(lower[dofs - ROOT_DOFS], upper[dofs - ROOT_DOFS], (LIMB_STARTS, len(dofs)))
        anew = _best_of(character, base, lines, refiner, jnp.asarray(start))
        cost, delta = anew if anew[0] < cost else (cost, delta)
    pose = clamp(skeleton, retract(skeleton, base, delta))
    return pose, keypoint_distance(skeleton, pose, lines)


def keypoint_distance(skeleton: Skeleton, pose: Pose, lines: LandmarkRays) -> float:
    """Measure the RMS distance of a pose's landmarks to the rays of keypoints, metres; NaN without any."""
    square = jnp.sum(lines.distances(landmark_positions(skeleton, pose)) ** 2, -1)
    return float(jnp.sqrt(jnp.mean(square, where=lines.weight > 0)))


def _best_of(
    character: Character, base: Pose, lines: LandmarkRays, refiner: AbstractRefiner, starts: Float[Array, "start dof"]
) -> tuple[float, Float[Array, "dof"]]:
    filled = np.pad(np.asarray(starts), ((0, -len(starts) % AT_ONCE), (0, 0)), mode="edge")
    calls = [
        _solve_starts(character, base, lines, refiner, jax.device_put(some))
        for some in np.split(filled, len(filled) // AT_ONCE)
    ]
    deltas, costs = (np.concatenate(found) for found in zip(*calls, strict=True))
    costs = np.where(np.isfinite(costs), costs, np.inf)
    winner = int(np.argmin(costs))
    return float(costs[winner]), jax.device_put(deltas[winner])


@cached_jit
def _solve_starts(
    character: Character, base: Pose, lines: LandmarkRays, refiner: AbstractRefiner, starts: Float[Array, "start dof"]
) -> tuple[Float[Array, "start dof"], Float[Array, "start"]]:
    skeleton = character.skeleton
    far = jnp.full(ROOT_DOFS, 20.0)
    lower = jnp.concatenate([-far, skeleton.lower - base.angles])
    upper = jnp.concatenate([far, skeleton.upper - base.angles])
    weight = jnp.asarray(skeleton.per_dof(root=1e-4, angles=0.05))

    def one(start: Array) -> tuple[Array, Array]:
        problem = RefineProblem(
            residual=lambda d: lines(character, retract(skeleton, base, d)),
            prior=jnp.zeros(skeleton.num_dofs),
            lower=lower,
            upper=upper,
            l1=jnp.zeros(skeleton.num_dofs),
            prior_weight=weight,
        )
        done = refiner.refine(problem, start)
        return done.value, done.objective

    return jax.lax.map(one, starts)
