"""A limb or the whole person that is lost: noticed, marked, listed, and found again."""

from dataclasses import replace

import jax
import numpy as np
import pytest
from perturbed import arm_away, moved, vertex_errors

from jaxmocap.character import with_limb
from jaxmocap.clip import ClipPlan
from jaxmocap.energies import search_energy
from jaxmocap.search import SearchPlan
from jaxmocap.track import FrameTracker, Tracker
from jaxmocap.track._sequence import motion_of
from jaxmocap.verdict import LostSpan, VerdictSettings, lost_spans
from jaxmocap.verdict._features import LIMB_FEATURES, limb_features
from jaxmocap.verdict._lost import FOREIGN, HIDDEN, JUMPING, LOST
from jaxmocap.verdict._sequence_verdict import without_lost

ENERGY = search_energy(uncovered_scale=4.0, step=2, sampling="nearest", fail="ignore", outside="ignore")
PLAN = SearchPlan(step=2, iterations=12, particles=64)
SETTINGS = VerdictSettings()


@pytest.fixture(scope="module")
def true_results(world):
    tracker = FrameTracker(world.observations(), Tracker(ENERGY, search=None, refine=None), jax.random.key(0))
    return [tracker.first(world.shown(frame), world.pose(frame)).result for frame in range(3)]


def spans(world, results, frame_logit=-2.5):
    skeleton, logit = world.character.skeleton, np.full(len(results), frame_logit)
    features = limb_features(results, skeleton, logit)
    return lost_spans(results, skeleton, features, logit > 0, SETTINGS)


def test_the_truth_is_not_lost(world, true_results):
    assert spans(world, true_results) == []
    assert min(result.limb_seen.min() for result in true_results) > 0.8


def test_every_reason_has_its_span(world, true_results):
    hidden = replace(true_results[1], limb_seen=np.array([1.0, 0.1, 1.0, 1.0]))
    foreign = replace(true_results[2], limb_costs=np.array([0.2, 0.2, 0.9, np.nan]))
    found = spans(world, [true_results[0], hidden, foreign])
    assert found == [LostSpan("right arm", 1, 1, HIDDEN), LostSpan("left leg", 2, 2, FOREIGN)]
    jumped = replace(true_results[1], pose=arm_away(world, 1))
    assert spans(world, [true_results[0], jumped, true_results[2]]) == [LostSpan("left arm", 1, 1, JUMPING)]
    assert (
        spans(world, [true_results[0], hidden, foreign], 2.0) == found
    )  # of a wrong frame only what is its limbs' own
    gone = [replace(result, status="lost", limb_seen=np.zeros(4)) for result in true_results[1:]]
    assert spans(world, [true_results[0], *gone]) == [LostSpan("body", 1, 2, LOST)]


def leaps(world, results):
    features = limb_features(results, world.character.skeleton, np.zeros(len(results)))
    return features[..., LIMB_FEATURES.index("leap")]


def standing(world, true_results, count, away=(), fps=30.0):
    """Frames in which nothing moves, but a limb that is elsewhere in those of `away`."""
    poses = [true_results[0].pose] * count
    for frame in away:
        poses[frame] = with_limb(poses[0], arm_away(world, 1), world.character.skeleton.group("l_arm"))
    return [replace(true_results[0], pose=pose, frame=frame, timestamp=frame / fps) for frame, pose in enumerate(poses)]


def test_only_the_frame_that_leaps_is_far_from_its_neighbours(world, true_results):
    jumped = replace(true_results[1], pose=arm_away(world, 1))
    order = [true_results[0], true_results[0], jumped, true_results[2], true_results[2]]
    found = leaps(world, [replace(result, timestamp=frame / 30) for frame, result in enumerate(order)])
    assert found[2, 0] > 1.0
    found[2, 0] = 0.0
    assert found.max() < 0.2


@pytest.mark.parametrize("away", [(0,), (1,), (3,), (4,), (1, 2), (2, 3)])
def test_the_frames_out_of_their_way_leap_at_the_ends_too_and_two_together(world, true_results, away):
    found = leaps(world, standing(world, true_results, 5 if len(away) < 2 else 6, away))
    assert (found[list(away), 0] > 0.2).all()
    assert np.sum(found > 0) == len(away)


def test_frames_far_apart_in_time_leave_room_for_a_swing(world, true_results):
    assert leaps(world, standing(world, true_results, 5, (2,), fps=4.0)).max() == 0
    assert leaps(world, standing(world, true_results, 5, (2,), fps=30.0)).max() > 0.2


def test_who_walks_on_while_frames_are_missing_does_not_leap(world, true_results):
    times = np.array([0, 1, 2, 3, 4, 5, 6, 14, 15, 16, 17, 18]) / 30
    results = []
    for frame, time in enumerate(times):
        pose = true_results[0].pose
        root = np.array(pose.root)
        root[0, 3] += 4.0 * time
        results.append(replace(true_results[0], frame=frame, timestamp=float(time), pose=replace(pose, root=root)))
    assert leaps(world, results).max() == 0


def test_what_is_said_of_a_frame_that_was_passed_over_lies_between_its_neighbours(world, true_results):
    results = standing(world, true_results, 5)
    results[3] = replace(results[3], limb_costs=np.full(4, 0.9))
    unknown = np.full(4, np.nan)
    results[2] = replace(
        results[2], pose=arm_away(world, 1), energy={}, signals=None, limb_costs=unknown, limb_seen=unknown
    )
    features = limb_features(results, world.character.skeleton, np.zeros(5))
    np.testing.assert_allclose(features[2], 0.5 * (features[1] + features[3]))


def test_lost_parts_have_no_confidence_and_others_keep_theirs(world, true_results):
    spans = [LostSpan("left arm", 1, 1, HIDDEN)]
    skeleton = world.character.skeleton
    marked = [without_lost(result.confidence, result.frame, spans, skeleton) for result in true_results]
    names = np.array(world.character.skeleton.landmark_names)
    arm = np.isin(names, ["l_elbow", "l_wrist"])
    assert (marked[1][arm] == 0).all()
    others = np.isin(names, ["r_wrist", "l_knee", "head"])
    np.testing.assert_array_equal(marked[1][others], true_results[1].confidence[others])
    assert true_results[1].confidence[arm].min() > 0
    np.testing.assert_array_equal(marked[0], true_results[0].confidence)


def test_spans_of_a_motion_count_as_its_frames_do(world, true_results):
    """The videos were started at different times: the capture's first frame is the first video's fourth."""
    observations, videos = world.observations(), world.capture.indices
    longer = replace(videos[0], pts=np.arange(7), seconds=np.arange(7) / 30)
    later = world.capture.video_frames + np.array([[4], [0]])
    observations.capture = replace(world.capture, indices=(longer, *videos[1:]), video_frames=later)
    hidden = replace(true_results[1], limb_seen=np.array([1.0, 0.1, 1.0, 1.0]))
    motion = motion_of(observations, [true_results[0], hidden, true_results[2]])
    assert motion.frames.tolist() == [4, 5, 6]
    assert [(span["first"], span["last"]) for span in motion.provenance["lost"]] == [(5, 5)]
    assert (motion.confidence.min(axis=1) == 0).tolist() == [False, True, False]


@pytest.mark.parametrize(("plan", "told"), [(None, {}), (ClipPlan(contacts=False), {"contacts": None})])
def test_a_motion_claims_no_contacts_that_were_not_looked_for(world, true_results, plan, told):
    motion = motion_of(world.observations(), true_results, clip=plan)
    assert {name: value for name, value in motion.provenance.items() if name == "contacts"} == told
    assert motion.contacts is None


@pytest.mark.slow
@pytest.mark.parametrize("times", [0, 3])
def test_a_person_who_was_lost_is_looked_for_further_afield(world, times):
    """The search's own reach is a few centimetres; from 60 cm aside only far particles lead back."""
    tracker = Tracker(ENERGY, replace(PLAN, relocalise=times), refine=None, flow_start=False)
    worker = FrameTracker(world.observations(), tracker, jax.random.key(0))
    first = worker.first(world.shown(1), moved(world, 1, root_tx=0.6))
    assert first.result.status == "lost"
    found = worker.track(first.state, world.shown(2)).result
    error = vertex_errors(world, 2, found.pose).mean()
    assert error < 0.05 if times else error > 0.1
