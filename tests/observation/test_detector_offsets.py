"""Where a detector sees the landmarks, learnt from frames whose pose is known."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from perturbed import perturbed
from synthetic_world import POINTS

from jaxmocap.camera import project
from jaxmocap.capture import Detections
from jaxmocap.character import body_transforms, landmark_positions
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
    """What a detector with these offsets finds; those of shoulders and hips go with the collar bones and the pelvis."""
    skeleton, view = world.character.skeleton, world.cameras.at(FRAME)
    turns = np.asarray(body_transforms(skeleton, pose))[:, :3, :3]
    places = dict(zip(skeleton.landmark_names, np.asarray(landmark_positions(skeleton, pose)), strict=True))
    carrier = dict(
        zip(skeleton.landmark_names, [skeleton.body_names[b] for b in skeleton.landmark_bodies], strict=True)
    )
    carrier |= {f"{side}_shoulder": f"{side}_clavicle" for side in "lr"} | {f"{side}_hip": "pelvis" for side in "lr"}
    seen = np.zeros((25, 3), np.float32)
    for name, point in POINTS.items():
        seen[point] = places[name] + turns[skeleton.body_names.index(carrier[name])] @ offsets[point]
    pixels, _ = project(view.intrinsics, view.cam_from_world, jnp.asarray(seen))
    found = np.isin(np.arange(25), ROWS).astype(np.float32)
    return np.stack([np.concatenate([np.asarray(p), found[:, None]], 1) for p in pixels])


@pytest.fixture(scope="module")
def poses(world):
    """Limbs move, and in every second pose the whole body turns, so that two views see offsets from all sides."""
    return [perturbed(world, FRAME, 25.0, seed=seed, kind=("joints", "root")[seed % 2]) for seed in range(30)]


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


@pytest.mark.slow
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
