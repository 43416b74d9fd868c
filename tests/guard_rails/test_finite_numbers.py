"""Values and gradients stay finite where something is missing, still, alike, behind the camera or beyond a limit.

`JAX_DEBUG_NANS=1 pytest -n 0 tests/guard_rails ...` also holds every value in between to it; see CONTRIBUTING.md.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from box_figure import box_character

from jaxmocap.appearance import ColourModel, ColourSettings, psi
from jaxmocap.camera import pixel_rays, project
from jaxmocap.character import (
    Pose,
    away_from_limits,
    clamp,
    difference,
    landmark_positions,
    points_and_jacobian,
    pose_vector,
    rest_pose,
    retract,
    skin,
)
from jaxmocap.energies import ContourSettings, bend, contour_points, covered_cost, edge_targets, uncovered_cost
from jaxmocap.geometry import huber, so3_exp, so3_log
from jaxmocap.motion import predict_difference
from jaxmocap.refiners import LeastSquares, RefineProblem, Shooting
from jaxmocap.render import SoftSettings, face_ids, inverse_depth_range, projection_matrices, soft_faces, to_screen
from jaxmocap.samplers import CrossEntropy, InteractingSimulatedAnnealing, RandomSearch, run

CHARACTER = box_character()
SKELETON = CHARACTER.skeleton
INTRINSICS = jnp.array([[120.0, 0, 32], [0, 120, 32], [0, 0, 1]])
FACING = jnp.array([[1.0, 0, 0, 0], [0, -1, 0, 1], [0, 0, -1, 3], [0, 0, 0, 1]])  # three metres in front
BEHIND = FACING.at[2, 3].set(-3.0)
INSIDE = FACING.at[2, 3].set(0.02)  # the camera stands in the body
CAMERAS = {"facing": FACING, "behind": BEHIND, "inside": INSIDE}


def finite(tree) -> bool:
    return all(bool(np.all(np.isfinite(np.asarray(leaf)))) for leaf in jax.tree.leaves(tree))


def poses() -> list[Pose]:
    """At rest, at both limits, beyond them, and turned over."""
    rng = np.random.default_rng(0)
    turned = rest_pose(SKELETON)
    vectors = [np.zeros(39), *(np.concatenate([np.zeros(6), limit]) for limit in (SKELETON.lower, SKELETON.upper))]
    vectors += [rng.normal(size=39) * np.pi for _ in range(3)]
    vectors += [np.concatenate([[0, 0, 0, np.pi, 0, 0], np.zeros(33)]), np.concatenate([np.full(6, 1e3), np.ones(33)])]
    return [retract(SKELETON, turned, jnp.asarray(vector, jnp.float32)) for vector in vectors]


POSES = poses()
STACKED = jax.tree.map(lambda *leaves: jnp.stack(leaves), *POSES)


@pytest.mark.parametrize(
    "function",
    [
        lambda delta, pose: skin(CHARACTER, retract(SKELETON, pose, delta)),
        lambda delta, pose: landmark_positions(SKELETON, clamp(SKELETON, retract(SKELETON, pose, delta))),
        lambda delta, pose: difference(SKELETON, pose, retract(SKELETON, pose, delta)),
        lambda delta, pose: bend(SKELETON, pose.angles + delta[6:]),
    ],
    ids=["skin", "landmarks", "difference", "posture"],
)
def test_bodies_move_at_and_beyond_their_limits(function):

    def total(delta, pose):
        value = function(delta, pose)
        return jnp.sum(value**2), value

    both = jax.jit(jax.vmap(jax.value_and_grad(total, has_aux=True), (None, 0)))
    assert finite(both(jnp.zeros(39), STACKED))


def test_other_angles_of_shoulders_are_finite():
    for pose in POSES[:4]:
        assert finite((pose_vector(SKELETON, pose), away_from_limits(SKELETON, pose)))


def test_logarithms_at_the_identity_and_at_half_a_turn():
    turns = jnp.array([[0.0, 0, 0], [1e-9, 0, 0], [np.pi, 0, 0], [0, np.pi - 1e-6, 0], [0, 0, 2 * np.pi], [50.0, 1, 0]])
    back = lambda turn: so3_log(so3_exp(turn))  # noqa: E731
    all_of_it = jax.jit(jax.vmap(lambda turn: (back(turn), jax.jacfwd(back)(turn), jax.jacrev(back)(turn))))
    assert finite(all_of_it(turns))
    assert finite(jax.jit(jax.jacrev(so3_log))(jnp.diag(jnp.array([1.0, -1.0, -1.0]))))


@pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS.keys())
def test_projection_and_its_gradients(camera):
    centre = jnp.asarray(-np.asarray(camera[:3, :3]).T @ np.asarray(camera[:3, 3]))
    points = jnp.concatenate([CHARACTER.vertices, centre[None]])
    value = lambda at, pose: sum(jnp.sum(part) for part in project(INTRINSICS, pose, at))  # noqa: E731
    slope = jax.jit(jax.grad(value, (0, 1)))(points, camera)
    assert finite((project(INTRINSICS, camera, points), slope))
    pixels = jnp.array([[32.0, 32.0], [-1e6, 1e6]])
    rays = lambda k: sum(jnp.sum(part) for part in pixel_rays(k, camera, pixels))  # noqa: E731
    assert finite((pixel_rays(INTRINSICS, camera, pixels), jax.grad(rays)(INTRINSICS)))


@pytest.mark.parametrize("size", [(64, 64), (1, 1)], ids=["picture", "one pixel"])
def test_drawing_hard_and_soft(size):
    """In view; nothing in view, because the body is behind the camera; and around it."""

    @jax.jit
    def drawn(vertices, camera):
        def share(vertices):
            screen = to_screen(vertices, projection_matrices(INTRINSICS, camera), jnp.zeros(2, jnp.int32))
            depths = inverse_depth_range(vertices, camera)
            seen = soft_faces(screen, CHARACTER.faces.T, *size, depths, SoftSettings(1.0, 4, 256, 4096, 8192))
            return jnp.sum(seen.share**2) + 1e-3 * jnp.sum(seen.inverse_depth * seen.share), seen

        return jax.value_and_grad(share, has_aux=True)(vertices)

    for name, camera in CAMERAS.items():
        views = INTRINSICS[None], camera[None], jnp.zeros((1, 2), jnp.int32)
        ids, inverse = face_ids(CHARACTER.vertices, CHARACTER.faces, *views, *size)
        soft, slope = drawn(CHARACTER.vertices, camera)
        assert finite((inverse, soft, slope)), name
        shown = name == "facing" and size == (64, 64)
        assert np.any(np.asarray(ids) >= 0) == (float(jnp.abs(slope).max()) > 0) == shown, name


@pytest.mark.parametrize("metric", ["mahalanobis", "euclidean"])
def test_distances_of_colours_that_are_all_the_same(metric):
    """One cluster without extent, at its own mean; an element without any model; and no element."""
    model = ColourModel(
        means=jnp.full((2, 5, 3), 0.5),
        covariances=jnp.zeros((2, 5, 6)),
        weights=jnp.zeros((2, 5)).at[0, 0].set(1.0),
        valid=jnp.array([True, False]),
        cluster_count=jnp.array([1, 0], jnp.int32),
    )
    settings = ColourSettings(metric=metric, weights="neglog" if metric == "mahalanobis" else "off")
    ids, colours = jnp.array([0, 1, -1]), jnp.full((3, 3), 0.5)
    value = lambda means, seen: jnp.sum(psi(eqx.tree_at(lambda m: m.means, model, means), ids, seen, settings))  # noqa: E731
    assert finite((psi(model, ids, colours, settings), jax.grad(value, (0, 1))(model.means, colours)))


def test_costs_of_pixels_that_fit_both_models_exactly():
    none, slope = jnp.zeros(()), jax.grad(lambda f, b: covered_cost(f, b), (0, 1))
    assert finite((covered_cost(none, none), slope(none, none), uncovered_cost(none), jax.grad(uncovered_cost)(none)))
    assert finite((huber(none, 0.01), jax.grad(huber)(none, 0.01), jax.grad(huber)(jnp.asarray(1e12), 0.01)))


@pytest.mark.parametrize("filled", [False, True])
def test_contours_of_nothing_and_of_everything(filled):
    settings = ContourSettings()
    ids = jnp.full((32, 32), 0 if filled else -1, jnp.int32)
    points = contour_points(ids, jnp.full((32, 32), 0.3 if filled else 0.0), settings)
    flat = jnp.full((32, 32, 3), 0.5)
    known = jnp.zeros(len(points.face), bool)
    colours = jnp.zeros((len(points.face), 3))
    gradient = jnp.zeros((32, 32, 2))
    targets, accepted = edge_targets(points, jnp.ones((32, 32), bool), gradient, flat, colours, known, settings)
    assert finite((points.normal, targets))
    assert not np.any(accepted)


class Plane(eqx.Module):
    matrix: jax.Array
    offset: jax.Array

    def __call__(self, x):
        return jnp.matmul(self.matrix, x, precision="highest") + self.offset


@pytest.mark.parametrize("refiner", [Shooting(), LeastSquares()], ids=["shooting", "least squares"])
@pytest.mark.parametrize("norm", ["squared", "l2"])
def test_refinement_of_what_fits_exactly_or_says_nothing(refiner, norm):
    """A residual that is zero at the start, and one that no increment changes; with a prior and without."""
    zero, refine = jnp.zeros(4), eqx.filter_jit(lambda problem: refiner.refine(problem, jnp.zeros(4)))
    for plane in (Plane(jnp.eye(6, 4), jnp.zeros(6)), Plane(jnp.zeros((6, 4)), jnp.ones(6))):
        for weight in (0.0, 3.0):
            problem = RefineProblem(plane, zero, zero - 1, zero + 1, prior_weight=jnp.asarray(weight), norm=norm)
            found = refine(problem)
            assert finite((found.value, found.objective, found.stationarity))
            np.testing.assert_allclose(found.value, 0.0, atol=1e-3)


@pytest.mark.parametrize("level", [0.0, 1e30, np.inf, np.nan], ids=["alike", "huge", "infinite", "no number"])
@pytest.mark.parametrize(
    "sampler",
    [
        InteractingSimulatedAnnealing(24, 4),
        InteractingSimulatedAnnealing(24, 4, schedule="poly_raw", epsilon="zero", answer="mean"),
        CrossEntropy(24, 4),
        RandomSearch(24, 4),
    ],
    ids=["isa", "isa literal", "cross entropy", "random search"],
)
def test_searches_whose_particles_are_all_alike(sampler, level):
    start = jnp.array([0.1, 0.0, -0.2])
    energy = eqx.Partial(_level, jnp.asarray(level, jnp.float32))
    found = run(sampler, energy, start, jnp.full(3, 0.1), jnp.full(3, -1.0), jnp.full(3, 1.0), jax.random.key(0))[0]
    assert finite(found)
    assert np.all(np.abs(np.asarray(found)) <= 1)


def _level(level, particles):
    return jnp.full(len(particles), level)


@pytest.mark.parametrize("mode", ["ridge", "quadratic", "velocity"])
def test_predictions_of_no_motion_at_all(mode):
    still = jnp.zeros((12, 39))
    slope = jax.jit(jax.grad(lambda d: jnp.sum(predict_difference(d, mode=mode) ** 2)))
    for count in (0, 1, 12):
        assert finite((predict_difference(still, count, mode), slope(still)))
    np.testing.assert_array_equal(predict_difference(still, mode=mode), 0)


def test_jacobians_of_points_at_a_joint():
    joint = SKELETON.landmark("l_elbow")[None]
    weights = jnp.zeros((1, 18)).at[0, SKELETON.body_names.index("l_forearm")].set(1.0)
    assert finite(points_and_jacobian(SKELETON, POSES[1], joint, weights))
