"""A clip with a known answer, solved as a whole: smooth motion, feet that stand, and what single frames get wrong."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmocap.character import ROOT_DOFS, Pose, landmark_positions, pose_from_vector, rest_pose, retract
from jaxmocap.clip import ClipPlan, FlowSteps, _solve, find_contacts, solve_clip
from jaxmocap.clip._system import (
    ClipRows,
    body_points,
    energy_at,
    linearise,
    normal_equations,
    point_places,
    solve_bands,
    third_differences,
)
from jaxmocap.synthetic import actor_skeleton

UP = np.array([0.0, 1.0, 0.0])
DEVIATION = 0.01
"""Standard deviation of noise on every degree of freedom, metres and radians."""


@pytest.fixture(scope="module")
def skeleton():
    return actor_skeleton()


def poses_of(skeleton, vectors) -> Pose:
    return jax.vmap(lambda vector: pose_from_vector(skeleton, vector))(jnp.asarray(vectors, jnp.float32))


def places_of(skeleton, poses: Pose) -> np.ndarray:
    return np.asarray(jax.vmap(lambda pose: landmark_positions(skeleton, pose))(poses), np.float64)


def swinging(skeleton, frames: int = 60, fps: float = 30.0):
    """A person who stands on straight legs and swings trunk and arms inside the joint limits."""
    time = np.arange(frames) / fps
    vectors = np.zeros((frames, skeleton.num_dofs))
    middle = np.concatenate([np.zeros(ROOT_DOFS), np.asarray((skeleton.lower + skeleton.upper) / 2)])
    room = np.concatenate([np.zeros(ROOT_DOFS), np.asarray(skeleton.upper - skeleton.lower) / 2])
    for name, dofs in skeleton.groups:
        if name in ("root", "l_leg", "r_leg"):
            continue
        for dof in dofs:
            vectors[:, dof] = middle[dof] + 0.4 * room[dof] * np.sin(2 * np.pi * time / 1.5 + dof)
    return time, vectors


def noisy(skeleton, vectors, seed: int, deviation: float = DEVIATION) -> Pose:
    return poses_of(skeleton, vectors + np.random.default_rng(seed).normal(0, deviation, vectors.shape))


def rows_of(skeleton, time, vectors) -> ClipRows:
    random, points = np.random.default_rng(0), len(body_points(skeleton).body)
    half = random.normal(0, 2, (2, len(time), points, 3, 3))
    told, steady = half @ half.swapaxes(3, 4)
    return ClipRows(
        told=told,
        differences=third_differences(time),
        smooth=random.uniform(1e-6, 3e-6, (len(time) - 3, points)),
        steady=steady[1:],
        ways=random.normal(0, 0.1, (len(time) - 1, points, 3)),
        lower=np.full(vectors.shape, -0.02),
        upper=np.full(vectors.shape, 0.02),
        wall=10.0,
        near=2.0,
    )


def dropped(time: np.ndarray, seed: int = 0) -> np.ndarray:
    """Numbers of the frames that are left where two of five are missing, the first and the last not."""
    left = np.random.default_rng(seed).random(len(time)) < 0.6
    left[[0, -1]] = True
    return np.flatnonzero(left)


@pytest.mark.parametrize("speed", [0.25, 0.7])
def test_a_body_that_moves_evenly_is_left_where_it_is(skeleton, speed):
    time, vectors = swinging(skeleton, 12)
    vectors = np.repeat(vectors[:1], 12, axis=0)
    vectors[:, 0] = speed * time
    poses = poses_of(skeleton, vectors)
    solved = solve_clip(skeleton, poses, time)
    np.testing.assert_allclose(places_of(skeleton, solved.poses), places_of(skeleton, poses), atol=2e-5)
    assert solved.contacts == []  # feet that slide on do not stand


def test_a_thrown_body_is_left_where_it_is_whichever_frames_are_missing(skeleton):
    """Even acceleration has no jerk, if the time between frames counts: as if they were even, it moves by 2 cm."""
    time = np.arange(40) / 30
    time = time[dropped(time)]
    vectors = np.zeros((len(time), skeleton.num_dofs))
    vectors[:, 0], vectors[:, 1] = 5.0 * time, 6.0 * time - 4.905 * time**2
    poses = poses_of(skeleton, vectors)
    moved = [
        np.abs(places_of(skeleton, solve_clip(skeleton, poses, told).poses) - places_of(skeleton, poses)).max()
        for told in (time, np.arange(len(time)) / 30)
    ]
    assert moved[0] < 2e-4
    assert moved[1] > 0.01


def test_times_that_a_container_rounded_give_the_same_clip(skeleton):
    """At 60 frames a second and 5 m/s a millisecond of rounding would pass for a jerk of 1600 m/s^3."""
    time = np.arange(60) / 60
    vectors = np.zeros((60, skeleton.num_dofs))
    vectors[:, 0] = 5.0 * time
    poses = poses_of(skeleton, vectors)
    for ticks in (600, 1000):
        solved = solve_clip(skeleton, poses, np.round(time * ticks) / ticks)
        apart = places_of(skeleton, solved.poses) - places_of(skeleton, poses)
        assert np.abs(apart).max() < 1e-4


def test_sure_frames_stay_where_they_are(skeleton):
    time, vectors = swinging(skeleton)
    poses = poses_of(skeleton, vectors)
    solved = solve_clip(skeleton, poses, time, plan=ClipPlan(deviation=1e-6, contacts=False))
    np.testing.assert_allclose(places_of(skeleton, solved.poses), places_of(skeleton, poses), atol=1e-4)


@pytest.mark.parametrize("fps", [30.0, 120.0])
def test_noise_is_taken_out_at_any_frame_rate(skeleton, fps):
    time, vectors = swinging(skeleton, int(2 * fps), fps)
    true, found = places_of(skeleton, poses_of(skeleton, vectors)), noisy(skeleton, vectors, 1)
    solved = solve_clip(skeleton, found, time)
    errors = [np.linalg.norm(places_of(skeleton, poses) - true, axis=-1) for poses in (found, solved.poses)]
    assert errors[1].mean() < 0.75 * errors[0].mean()
    jolts = [
        np.linalg.norm(np.diff(places_of(skeleton, poses) - true, n=2, axis=0), axis=-1).mean() * fps**2
        for poses in (found, solved.poses)
    ]
    assert jolts[1] < 0.25 * jolts[0]


def test_a_limb_without_confidence_is_carried_by_the_frames_around(skeleton):
    time, vectors = swinging(skeleton)
    wrong, wrist = vectors.copy(), skeleton.landmark_names.index("l_wrist")
    wrong[29:32, skeleton.dof_names.index("l_shoulder_abd")] += 0.15
    poses = [poses_of(skeleton, values) for values in (vectors, wrong)]
    true = places_of(skeleton, poses[0])[:, wrist]
    confidence = np.ones((len(time), len(skeleton.landmark_names)))
    confidence[29:32, [name.startswith("l_") for name in skeleton.landmark_names]] = 0.0
    sure, unsure = (solve_clip(skeleton, poses[1], time, given).poses for given in (None, confidence))
    errors = [np.linalg.norm(places_of(skeleton, p)[:, wrist] - true, axis=1).max() for p in (poses[1], sure, unsure)]
    assert errors[2] < 0.7 * errors[1] < errors[0], errors


def test_ways_that_flow_has_seen_bring_a_clip_nearer_to_the_truth(skeleton):
    time, vectors = swinging(skeleton)
    points, zero = body_points(skeleton), np.zeros(vectors.shape)
    true, found = poses_of(skeleton, vectors), noisy(skeleton, vectors, 1)
    places = linearise(skeleton, points, true, zero)[0]
    ways = np.diff(places, axis=0) + np.random.default_rng(2).normal(0, 0.002, (len(time) - 1, *places.shape[1:]))
    seen = FlowSteps(ways, 0.002**2 * np.broadcast_to(np.eye(3), (*ways.shape, 3)))
    nothing = FlowSteps(
        np.ones(ways.shape), 1e4 * np.broadcast_to(np.eye(3), (*ways.shape, 3))
    )  # a metre per frame, give or take a hundred
    alone, better, same = (solve_clip(skeleton, found, time, steps=steps).poses for steps in (None, seen, nothing))
    errors = [places_of(skeleton, poses) - places_of(skeleton, true) for poses in (alone, better)]
    for order in (0, 1, 2):
        before, after = (np.linalg.norm(np.diff(apart, n=order, axis=0), axis=-1).mean() for apart in errors)
        assert after < 0.8 * before, order
    np.testing.assert_allclose(places_of(skeleton, same), places_of(skeleton, alone), atol=1e-4)


def test_a_direction_of_which_frames_say_little_counts_less(skeleton):
    """Bodies that err along one axis alone, each frame as its J^T J says."""
    time, vectors = swinging(skeleton)
    wrong = vectors.copy()
    wrong[:, 2] += np.random.default_rng(3).normal(0, 0.01, len(time))
    information = np.diag(np.full(skeleton.num_dofs, 1e6))
    information[2, 2] = 1e4  # 1 cm, where a tenth of that is left open in all others
    true, found = places_of(skeleton, poses_of(skeleton, vectors)), poses_of(skeleton, wrong)
    alike, told = (
        np.abs(places_of(skeleton, solve_clip(skeleton, found, time, hessians=hessians).poses) - true).mean((0, 1))
        for hessians in (None, [None, *[information] * (len(time) - 1)])
    )
    assert told[2] < 0.92 * alike[2]  # a weight that is a twentieth lets jerks through by its sixth root
    assert told[:2].max() < 1e-3


def test_feet_that_stand_are_found_and_stay(skeleton):
    time, vectors = swinging(skeleton)
    found = noisy(skeleton, vectors, 2, 0.003)  # 5 mm at the feet, the noise that the plan expects
    solved = solve_clip(skeleton, found, time)
    assert {contact.landmark for contact in solved.contacts} == {"l_heel", "l_toe", "r_heel", "r_toe"}
    sliding = solve_clip(skeleton, found, time, plan=ClipPlan(contacts=False))
    assert sliding.contacts is None  # they were not looked for
    assert solve_clip(skeleton, poses_of(skeleton, vectors[:3]), time[:3]).contacts is None  # too few frames
    for name, first, last in solved.contacts:
        point, interval = skeleton.landmark_names.index(name), slice(first, last + 1)
        paths = [places_of(skeleton, clip.poses)[interval, point] for clip in (solved, sliding)]
        still, slid = (np.linalg.norm(np.diff(path, axis=0), axis=1).mean() for path in paths)
        assert still < 0.3 * slid, (name, still, slid)


def test_feet_in_the_air_do_not_stand(skeleton):
    time, vectors = swinging(skeleton)
    vectors[:, 1] = 0.6 * np.abs(np.sin(2 * np.pi * time))  # hops
    contacts = find_contacts(places_of(skeleton, poses_of(skeleton, vectors)), time, skeleton, UP)
    for contact in contacts:
        assert vectors[contact.first : contact.last + 1, 1].max() < 0.06, contact


def test_a_foot_that_is_held_up_does_not_stand(skeleton):
    time, vectors = swinging(skeleton)
    vectors[:] = vectors[:1]
    places = places_of(skeleton, poses_of(skeleton, vectors))
    assert {name[0] for name, _, _ in find_contacts(places, time, skeleton, UP)} == {"l", "r"}
    right = [skeleton.landmark_names.index(name) for name in ("r_heel", "r_toe")]
    places[:, right] += 0.3 * UP
    assert {name[0] for name, _, _ in find_contacts(places, time, skeleton, UP)} == {"l"}
    assert find_contacts(places * [1, -1, 1], time, skeleton, UP) == []  # head down


def test_no_foot_stands_over_a_gap_in_which_it_may_have_stepped(skeleton):
    """Five centimetres in a second are slow, and a step that nobody saw."""
    time, vectors = swinging(skeleton, 20)
    vectors[:] = vectors[:1]
    vectors[10:, 0] += 0.05
    places = places_of(skeleton, poses_of(skeleton, vectors))
    for gap, spans in ((1.0, {(0, 9), (10, 19)}), (0.2, {(0, 19)})):
        contacts = find_contacts(places, time + np.where(np.arange(20) < 10, 0.0, gap), skeleton, UP)
        assert {(first, last) for _, first, last in contacts} == spans


def test_joint_limits_hold(skeleton):
    time, vectors = swinging(skeleton)
    found = noisy(skeleton, vectors, 3)
    found = Pose(found.root, jnp.clip(found.angles, skeleton.lower, skeleton.upper))
    solved = solve_clip(skeleton, found, time)
    assert bool((solved.poses.angles >= skeleton.lower - 1e-6).all())
    assert bool((solved.poses.angles <= skeleton.upper + 1e-6).all())


def test_a_long_clip_is_solved_in_windows(skeleton, monkeypatch):
    time, vectors = swinging(skeleton, 100)
    found = noisy(skeleton, vectors, 8)
    whole = solve_clip(skeleton, found, time)
    monkeypatch.setattr(_solve, "WINDOW", 64)
    monkeypatch.setattr(_solve, "MARGIN", 20)
    parts = solve_clip(skeleton, found, time)
    assert parts.contacts == whole.contacts
    apart = places_of(skeleton, parts.poses) - places_of(skeleton, whole.poses)
    assert np.abs(apart).max() < 1e-3


def test_same_bits_every_time(skeleton):
    time, vectors = swinging(skeleton)
    found = noisy(skeleton, vectors, 4)
    one, two = (solve_clip(skeleton, found, time) for _ in range(2))
    assert np.array_equal(np.asarray(one.poses.angles), np.asarray(two.poses.angles))
    assert np.array_equal(np.asarray(one.poses.root), np.asarray(two.poses.root))


def test_the_gradient_is_that_of_finite_differences(skeleton):
    time, vectors = swinging(skeleton, 6)
    poses, rows, points = noisy(skeleton, vectors, 5), rows_of(skeleton, time, vectors), body_points(skeleton)
    at = np.random.default_rng(6).normal(0, 0.03, vectors.shape).astype(np.float32)

    def places(increments):
        moved = jax.vmap(lambda pose, step: retract(skeleton, pose, step))(poses, increments)
        return jax.vmap(lambda pose: point_places(skeleton, points, pose))(moved)

    there = places(jnp.zeros(at.shape))
    energy = jax.jit(lambda increments: energy_at(there, places(increments), increments, rows))
    gradient = jax.grad(energy)(jnp.asarray(at))
    assert bool(jnp.isfinite(gradient).all())
    found, _ = linearise(skeleton, points, poses, np.zeros_like(at))
    ours = 2 * normal_equations(found, *linearise(skeleton, points, poses, at), at, rows).gradient
    np.testing.assert_allclose(ours, gradient, rtol=2e-3, atol=2e-3 * float(jnp.abs(gradient).max()))
    for seed in range(3):
        way, step = np.random.default_rng(seed).normal(0, 1, vectors.shape).astype(np.float32), 1e-2
        ahead, behind = (float(energy(at + sign * step * way)) for sign in (1, -1))
        assert (ahead - behind) / (2 * step) == pytest.approx(float(np.vdot(gradient, way)), rel=0.02)


def test_third_derivatives_of_cubics_are_exact_between_uneven_frames():
    time = np.array([0.0, 0.1, 0.15, 0.4, 0.5])
    windows = np.lib.stride_tricks.sliding_window_view(2 * time**3 - time**2 + 3, 4)
    np.testing.assert_allclose((third_differences(time) * windows).sum(1), 12.0, rtol=1e-9)


def test_banded_systems_are_solved(skeleton):
    random, frames, size = np.random.default_rng(7), 5, 4
    dense = np.zeros((frames * size, frames * size))
    for first in range(frames - 2):
        rows = np.zeros((20, frames * size))
        rows[:, first * size : (first + 3) * size] = random.normal(size=(20, 3 * size))
        dense += rows.T @ rows
    blocks = dense.reshape(frames, size, frames, size).transpose(0, 2, 1, 3)
    bands = np.zeros((3, frames, size, size))
    for band in range(3):
        for frame in range(frames - band):
            bands[band, frame] = blocks[frame, frame + band]
    right = random.normal(size=(frames, size))
    expected = np.linalg.solve(dense, right.ravel()).reshape(frames, size)
    np.testing.assert_allclose(solve_bands(bands, right), expected, rtol=1e-5)


def test_three_frames_are_no_clip(skeleton):
    poses = jax.tree.map(lambda leaf: jnp.stack([leaf] * 3), rest_pose(skeleton))
    solved = solve_clip(skeleton, poses, np.array([0.0, 0.1, 0.2]))
    assert solved.poses is poses
