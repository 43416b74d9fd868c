"""Left and right of a person who is followed: exchanged answers are put right, and real movement is left as it is."""

from functools import lru_cache

import numpy as np
import pytest

from jaxmocap.character import landmark_positions
from jaxmocap.detection import BODY_25, LAYOUTS, FollowedPerson, believed
from jaxmocap.detection._left_right import WEIGHTS, exchanged, exchanged_sides, mirrored_points
from jaxmocap.synthetic import make_actor, perform

SIDE = 400.0
MIRRORED = mirrored_points(BODY_25)


@lru_cache
def performed(routine: str) -> tuple[np.ndarray, np.ndarray]:
    """Places of the joints of a routine, in metres, and their rows in BODY_25; eight in a second."""
    skeleton = make_actor().skeleton
    poses = perform(routine, skeleton, np.arange(32) / 8)
    rows = [row for row, name in enumerate(BODY_25.points) if name[2:] in WEIGHTS]
    columns = [skeleton.landmark_names.index(BODY_25.points[row]) for row in rows]
    moments = [landmark_positions(skeleton, type(poses)(poses.root[k], poses.angles[k])) for k in range(32)]
    return np.stack(moments)[:, columns], np.array(rows)


def followed(azimuth=0.0, fps=30.0, count=30, speed=1.0, routine="dance", turns=0.0) -> FollowedPerson:
    """Keypoints of a dancer, seen from a side (degrees), who turns so many times round in a second."""
    joints, rows = performed(routine)
    at = np.clip(8 * speed * np.arange(count) / fps, 0, len(joints) - 1.001)
    share, first = (at % 1)[:, None, None], at.astype(int)
    places = (1 - share) * joints[first] + share * joints[first + 1]
    angle = np.radians(azimuth) + 2 * np.pi * turns * np.arange(count) / fps
    across = places[..., 0] * np.cos(angle)[:, None] - places[..., 2] * np.sin(angle)[:, None]
    points = np.zeros((count, 25, 3))
    points[:, rows, 0], points[:, rows, 1], points[:, rows, 2] = 480 + 180 * across, 450 - 180 * places[..., 1], 1.0
    points[..., :2] += 3.0 * np.random.default_rng(3).normal(size=points[..., :2].shape)
    return FollowedPerson(np.arange(count), points, points[..., 2].copy(), np.full(count, SIDE), ())


def exchanging(person: FollowedPerson, frames) -> FollowedPerson:
    points, scores = person.points.copy(), person.scores.copy()
    points[frames], scores[frames] = points[frames][:, MIRRORED], scores[frames][:, MIRRORED]
    return FollowedPerson(person.frames, points, scores, person.sides, person.notes)


@pytest.mark.parametrize("azimuth", [0, 40, 180, 215])
@pytest.mark.parametrize("frames", [[0, 1, 2], [20], [4, 5, 6, 15, 16, 17, 18], list(range(18, 30))])
def test_exchanged_pictures_are_put_right(azimuth, frames):
    right = followed(azimuth)
    mended = believed(exchanging(right, frames), (960, 540))
    np.testing.assert_array_equal(mended.points[..., :2], right.points[..., :2])
    np.testing.assert_array_equal(mended.scores, right.scores)


@pytest.mark.parametrize("routine", ["dance", "crossing arms"])
@pytest.mark.parametrize("fps", [8.0, 15.0, 60.0])
def test_nothing_is_exchanged_in_fast_movement_seen_from_any_side(routine, fps):
    for azimuth in range(0, 360, 30):
        person = followed(azimuth, fps, speed=2.0, routine=routine)
        assert not exchanged_sides(person.points, person.sides, person.frames).any(), azimuth


def test_somebody_who_turns_round_in_a_second_stays_who_they_are():
    for start in range(0, 360, 30):
        person = followed(start, fps=10.0, turns=1.0, speed=0.5)
        assert not exchanged_sides(person.points, person.sides, person.frames).any(), start


def test_what_is_put_right_stays_right_and_a_break_tells_nothing():
    mended = believed(exchanging(followed(), [4, 5, 6]), (960, 540))
    again = believed(mended, (960, 540))
    np.testing.assert_array_equal(mended.points, again.points)
    later = exchanging(followed(count=12), np.arange(8, 12))
    frames = later.frames + 500 * (later.frames >= 8)
    assert not exchanged_sides(later.points, later.sides, frames).any()


def test_a_person_who_was_not_found_between_is_no_obstacle_and_pictures_with_nobody_are_none():
    person = exchanging(followed(), np.arange(20, 24))
    person.points[18:20], person.sides[18:20] = 0.0, 0.0
    assert np.flatnonzero(exchanged_sides(person.points, person.sides, person.frames)).tolist() == [20, 21, 22, 23]
    assert exchanged_sides(np.zeros((0, 25, 3)), np.zeros(0), np.zeros(0, int)).tolist() == []
    assert not exchanged_sides(np.zeros((3, 0, 3)), np.zeros(3), np.arange(3)).any()


def test_two_answers_to_one_picture_that_exchange_the_sides_are_told():
    points = followed().points[0]
    near = points + (2.0, -1.0, 0.0)
    assert exchanged(points, near[MIRRORED], BODY_25, SIDE)
    assert not exchanged(points, near, BODY_25, SIDE)


def test_every_point_has_its_counterpart():
    for layout in LAYOUTS.values():
        mirrored = mirrored_points(layout)
        assert [mirrored[row] for row in mirrored] == list(range(len(layout.points)))
        assert layout.points[mirrored[layout.points.index("l_wrist")]] == "r_wrist"
