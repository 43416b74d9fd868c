"""Verdicts on frames whose pixels are made up."""

import numpy as np
import pytest

from jaxmocap.character import dominant_bodies
from jaxmocap.search import DrawnPose, Evidence
from jaxmocap.verdict import VerdictSettings, judge_frame

SETTINGS = VerdictSettings()


@pytest.fixture(scope="module")
def bodies(world):
    return dominant_bodies(world.character)


def judge(world, ids, costs, speed=0.0):
    drawn = DrawnPose(world.pose(0), ids, costs, np.zeros((len(ids), 0), int))
    return judge_frame(Evidence.of(world.character), drawn, SETTINGS, speed)


def pixels(bodies, shown, count=60):
    """Face ids of a picture that shows `count` pixels of each of the bodies numbered in `shown`."""
    ids = np.full((1, len(shown) + 1, count), -1)
    for row, body in enumerate(shown):
        ids[0, row] = np.flatnonzero(bodies == body)[0]
    return ids


def test_every_face_belongs_to_the_body_that_moves_it_most(world, bodies):
    names = world.character.skeleton.body_names
    assert bodies.shape == (len(world.character.faces),)
    centres = np.asarray(world.character.vertices)[np.asarray(world.character.faces)].mean(1)
    heads, feet = centres[bodies == names.index("head"), 1], centres[bodies == names.index("l_foot"), 1]
    assert heads.min() > 1.3
    assert feet.max() < 0.25
    assert set(bodies) == set(range(len(names)))


def test_nothing_covered_is_lost(world, bodies):
    ids = np.full((2, 8, 8), -1)
    confidence, status, covered_cost = judge(world, ids, np.zeros((2, 8, 8)))
    assert status == "lost"
    assert covered_cost == 1.0
    np.testing.assert_array_equal(confidence, 0)


@pytest.mark.parametrize(
    ("cost", "speed", "status"),
    [
        (0.1, 0.0, "ok"),
        (SETTINGS.lost - 0.01, 0.0, "ok"),
        (SETTINGS.lost + 0.01, 0.0, "lost"),
        (0.1, SETTINGS.top_speed + 1, "doubtful"),
        (0.1, 2 * SETTINGS.top_speed + 1, "lost"),
    ],
)
def test_status_follows_cost_and_speed(world, bodies, cost, speed, status):
    ids = pixels(bodies, range(18))
    confidence, found, covered_cost = judge(world, ids, np.full(ids.shape, cost), speed)
    assert found == status
    assert covered_cost == pytest.approx(cost)
    np.testing.assert_allclose(confidence, np.clip(1.25 - 1.75 * cost, 0, 1), atol=1e-12)


def test_pixels_that_are_not_covered_do_not_count(world, bodies):
    ids = pixels(bodies, range(18))
    costs = np.where(ids >= 0, 0.1, 1.0)
    assert judge(world, ids, costs)[2] == pytest.approx(0.1)


def test_a_badly_explained_limb_lowers_its_own_landmarks_only(world, bodies):
    skeleton = world.character.skeleton
    ids, forearm = pixels(bodies, range(18)), skeleton.body_names.index("l_forearm")
    costs = np.full(ids.shape, 0.1)
    costs[0, forearm] = 0.9
    confidence, _, _ = judge(world, ids, costs)
    low = np.array(skeleton.landmark_bodies) == forearm
    assert "l_elbow" in np.array(skeleton.landmark_names)[low]
    np.testing.assert_array_equal(confidence[low], 0)
    assert np.all(confidence[~low] == 1)


def test_a_hidden_body_takes_the_confidence_of_its_nearest_visible_ancestor(world, bodies):
    skeleton = world.character.skeleton
    names = skeleton.body_names
    shown = [i for i, name in enumerate(names) if name not in ("l_forearm", "l_hand")]
    ids = pixels(bodies, shown)
    costs = np.full(ids.shape, 0.1)
    costs[0, shown.index(names.index("l_upper_arm"))] = 0.5
    confidence, _, _ = judge(world, ids, costs)
    at = dict(zip(skeleton.landmark_names, confidence, strict=True))
    assert at["l_wrist"] == at["l_elbow"] == at["l_shoulder"] == pytest.approx(1.25 - 1.75 * 0.5)
    assert at["r_wrist"] == 1


def test_a_hidden_pelvis_takes_the_mean_over_everything(world, bodies):
    skeleton = world.character.skeleton
    head = skeleton.body_names.index("head")
    ids = pixels(bodies, [head])
    confidence, _, _ = judge(world, ids, np.full(ids.shape, 0.3))
    np.testing.assert_allclose(confidence, 1.25 - 1.75 * 0.3, atol=1e-12)
