"""Every baseline tracks a frame of the synthetic world from the true pose of the one before."""

import json
from types import SimpleNamespace

import jax
import numpy as np
import pytest
from synthetic_world import POINTS

from jaxmocap._results import InputError
from jaxmocap.baselines import (
    METHODS,
    KeypointFit,
    KeypointTriangulation,
    PoseCut,
    SegmentAndFit,
    method,
    selected_histograms,
)
from jaxmocap.camera import View
from jaxmocap.capture import Detections
from jaxmocap.character import difference, skin
from jaxmocap.track import FrameTracker, Tracker, track


def error(world, pose, frame) -> float:
    """Mean distance of the skin to where it is, centimetres."""
    return 100 * np.linalg.norm(np.asarray(skin(world.character, pose)) - world.vertices(frame), axis=1).mean()


def found(world, tracker, detections=None):
    """The error in frame 2, tracked from the truth of frame 1."""
    observations = world.observations(detections)
    key = jax.random.key(0)
    own = isinstance(tracker, Tracker)
    worker = FrameTracker(observations, tracker, key) if own else tracker.follow(observations, key)
    state = worker.first(world.shown(1), world.pose(1)).state
    result = worker.track(state, world.shown(2)).result
    assert result.frame == 2
    assert result.status in ("ok", "doubtful", "lost")
    limits = world.character.skeleton
    assert np.all(result.pose.angles >= limits.lower - 1e-4)
    assert np.all(result.pose.angles <= limits.upper + 1e-4)
    return error(world, result.pose, 2)


@pytest.fixture(scope="module")
def stood_still(world) -> float:
    """The error of a method that does nothing."""
    still = error(world, world.pose(1), 2)
    assert still > 1.0
    return still


@pytest.mark.slow
def test_perfect_keypoints_place_the_body_to_a_centimetre(world, stood_still, tmp_path):
    folder = world.write_keypoints(tmp_path / "keypoints", range(3))
    assert found(world, KeypointTriangulation(), Detections.open(world.capture, folder)) < 0.8


def test_keypoint_triangulation_asks_for_keypoints(world):
    with pytest.raises(InputError, match=r"keypoints at every frame.*find them with jaxmocap detect"):
        track(world.observations(), tracker=KeypointTriangulation())


@pytest.mark.slow
def test_a_view_that_sees_nothing_takes_no_weight_from_the_others(world):
    view, three = world.cameras.at(2), np.array([0, 1, 1])
    view = View(view.intrinsics[three], view.cam_from_world[three])
    keypoints = world.keypoints(2)
    problem = SimpleNamespace(keypoints=np.concatenate([keypoints, np.zeros_like(keypoints[:1])]))
    worker = SimpleNamespace(character=world.character, cameras=SimpleNamespace(at=lambda frame: view))
    pose = KeypointTriangulation().find(worker, SimpleNamespace(number=2, problem=problem), world.pose(1))
    assert error(world, pose, 2) < 0.8


@pytest.mark.slow
def test_too_few_keypoints_leave_the_last_pose(world, stood_still, tmp_path):
    folder = world.write_keypoints(tmp_path / "keypoints", [0])
    assert found(world, KeypointTriangulation(), Detections.open(world.capture, folder)) == pytest.approx(
        stood_still, abs=0.05
    )


@pytest.mark.slow
def test_a_fit_to_perfect_keypoints_places_the_body_whatever_one_of_them_says(world, stood_still, tmp_path):
    folder = world.write_keypoints(tmp_path / "keypoints", range(3))
    assert found(world, KeypointFit(), Detections.open(world.capture, folder)) < 0.8
    path = next(folder.glob("cam0_00002*"))
    points = json.loads(path.read_text())
    wrist = 3 * POINTS["r_wrist"]
    points["people"][0]["pose_keypoints_2d"][wrist] += 100.0
    path.write_text(json.dumps(points))
    assert found(world, KeypointFit(), Detections.open(world.capture, folder)) < 1.2


@pytest.mark.slow
def test_segment_and_fit_follows_the_outline(world, stood_still):
    assert found(world, SegmentAndFit(iterations=1)) < stood_still


@pytest.mark.slow
def test_more_iterations_follow_it_too(world, stood_still):
    assert found(world, SegmentAndFit(iterations=5)) < stood_still


def test_the_colours_of_the_selected_frames_tell_the_person_from_the_ground(world):
    crops = [world.rectangle(2).crop(image, c) for c, image in enumerate(world.truth.images[2])]
    for colours, crop, mask in zip(selected_histograms(world.observations()), crops, world.masks(2), strict=True):
        person, ground = colours.costs(crop)
        assert ((person < ground) == mask).mean() > 0.85


@pytest.mark.slow
def test_posecut_minimises_its_energy_whose_minimum_is_near_the_person(world):
    baseline = PoseCut()
    worker = baseline.follow(world.observations(), jax.random.key(0))
    state = worker.first(world.shown(1), world.pose(1)).state
    energy = baseline.energy(worker, world.frame(2), world.pose(1))
    step = lambda pose: np.asarray(difference(world.character.skeleton, world.pose(1), pose))  # noqa: E731
    sideways = np.zeros(39)
    sideways[0] = 0.3
    assert energy(step(world.pose(2))) < energy(np.zeros(39)) < energy(sideways)
    pose = worker.track(state, world.shown(2)).result.pose
    assert energy(step(pose)) < energy(step(world.pose(2)))  # colours' best fit is not the truth
    assert error(world, pose, 2) < 4.5


def test_posecut_s_slope_is_that_of_differences(world):
    """Of steps that move outlines by pixels, for they are drawn in pixels."""
    baseline = PoseCut(masks=lambda camera, frame: world.truth.masks[frame][camera])
    energy = baseline.energy(baseline.follow(world.observations(), jax.random.key(0)), world.frame(2), world.pose(1))
    unit = world.character.skeleton.initial_spread
    slope = energy.slope(np.zeros(39), unit) * unit
    moves = 0.1 * unit * np.eye(39)
    measured = np.array([energy(move) - energy(-move) for move in moves]) / 0.2
    assert np.corrcoef(slope, measured)[0, 1] > 0.95
    assert slope @ measured / (measured @ measured) == pytest.approx(1.0, abs=0.15)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "most"), [("local", 1.2), ("annealed-particle-filter", 3.0), ("cma-es", 1.3)])
def test_the_tracker_s_energy_under_other_optimisers(world, name, most):
    """Standing still is off by 1.65 cm: 39 dimensions at once are too many for a particle filter of this budget."""
    if name == "cma-es":
        pytest.importorskip("evosax")
    assert found(world, method(name, "draft")) < most


def test_methods_by_name():
    assert isinstance(method("ours", "draft"), Tracker)
    with pytest.raises(InputError, match="ours, ours-with-keypoints, local"):
        method("nothing")
    assert len(METHODS) == 14
