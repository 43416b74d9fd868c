"""Where a detector sees the landmarks, learnt from frames whose pose is known."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from perturbed import perturbed
from synthetic_world import POINTS

from jaxmocap.capture import Detections
from jaxmocap.energies import keypoint_rays
from jaxmocap.observation import DetectorOffsets
from jaxmocap.refinement import DetectionPlan
from jaxmocap.track import Checkpoint, FrameTracker, Tracker
from jaxmocap.track._checkpoint import Saved

FRAME = 1
ROWS = sorted(POINTS.values())


@pytest.fixture(scope="module")
def offsets() -> np.ndarray:
    """Three centimetres in any direction, for every point."""
    vectors = np.random.default_rng(0).normal(size=(25, 3))
    return (0.03 * vectors / np.linalg.norm(vectors, axis=1, keepdims=True)).astype(np.float32)


def seen_with(world, pose, offsets) -> np.ndarray:
    """What a detector with these offsets finds."""
    skeleton = world.character.skeleton
    rows = np.array([skeleton.landmark_names.index(name) for name in POINTS])
    moved = jnp.asarray(skeleton.landmarks).at[rows].add(offsets[list(POINTS.values())])
    other = eqx.tree_at(lambda c: c.skeleton.landmarks, world.character, moved)
    return replace(world, truth=replace(world.truth, character=other)).keypoints(FRAME, pose)


@pytest.fixture(scope="module")
def poses(world):
    return [perturbed(world, FRAME, 25.0, seed=seed) for seed in range(30)]


def learnt(world, poses, offsets, spoil=lambda number, points: points) -> DetectorOffsets:
    known, view = DetectorOffsets.start(), world.cameras.at(FRAME)
    for number, pose in enumerate(poses):
        points = spoil(number, seen_with(world, pose, offsets))
        known = known.learn(world.character.skeleton, pose, view, points)
    return known


def test_offsets_of_every_landmark_are_found(world, poses, offsets):
    found = learnt(world, poses, offsets).metres()
    assert np.linalg.norm(found - offsets, axis=1)[ROWS].max() < 0.003
    np.testing.assert_array_equal(np.delete(found, ROWS, axis=0), 0)  # of points that are not found or no landmark


def test_one_frame_tells_less_than_it_shows(world, poses, offsets):
    found = learnt(world, poses[:1], offsets).metres()[ROWS]
    share = np.sum(found * offsets[ROWS], axis=1) / np.sum(offsets[ROWS] ** 2, axis=1)
    assert 0.1 < np.median(share) < 0.8
    assert share.max() < 1


def test_gross_errors_count_little(world, poses, offsets):
    def spoil(number, points):
        if number % 5 == 4:
            points[:, ROWS, :2] += 60.0
        return points

    found = learnt(world, poses, offsets, spoil).metres()
    assert np.linalg.norm(found - offsets, axis=1)[ROWS].max() < 0.006


def test_rays_with_the_offsets_have_no_residual_at_the_pose(world, poses, offsets):
    skeleton, view = world.character.skeleton, world.cameras.at(FRAME)
    points = jnp.asarray(seen_with(world, poses[0], offsets))

    def furthest(**told) -> float:
        rays = keypoint_rays(skeleton, view.intrinsics, view.cam_from_world, points, **told)
        found = np.linalg.norm(np.asarray(rays.distances(rays.landmarks(skeleton, poses[0]))), axis=1)
        return float(found[np.asarray(rays.weight) > 0].max())

    assert furthest() > 0.02
    assert furthest(offsets=jnp.asarray(offsets)) < 2e-4


def test_the_tracker_learns_from_selected_frames_and_those_it_trusts_and_keeps_it(world, tmp_path, offsets):
    folder = world.write_keypoints(tmp_path / "keypoints", range(3))
    observations = world.observations(Detections.open(world.capture, folder))
    tracker = Tracker(search=None, refine=None, detections=DetectionPlan())
    worker = FrameTracker(observations, tracker, jax.random.key(0))
    first = worker.first(world.shown(0), world.pose(0)).state
    selected = observations.detector()
    assert np.abs(selected.metres()).max() < 1e-4  # these keypoints are without error
    assert (np.trace(first.detector.square, axis1=1, axis2=2) > np.trace(selected.square, axis1=1, axis2=2))[ROWS].all()
    checkpoint = Checkpoint(tmp_path / "kept")
    checkpoint.save(Saved({}, 0, 0, first, worker.sizes()), observations)
    again = Checkpoint(tmp_path / "kept").load(observations).state.detector
    np.testing.assert_array_equal(again.square, first.detector.square)
    np.testing.assert_array_equal(again.slope, first.detector.slope)
    photometric = FrameTracker(world.observations(), Tracker(search=None, refine=None), jax.random.key(0))
    assert photometric.first(world.shown(0), world.pose(0)).state.detector is None
