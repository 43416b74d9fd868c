"""Points that jump away for a single picture, and files of one person."""

import numpy as np
import pytest

from jaxmocap._results import InputError
from jaxmocap.detection import FollowedPerson, believed, read_person, read_video, write_person


def moving(count=30, noise=1.0):
    random = np.random.default_rng(1)
    time = np.arange(count)[:, None] / 30
    places = np.stack(
        [300 + 200 * np.sin(2 * time + np.arange(33)), 300 + 150 * np.cos(3 * time) + 0 * np.arange(33)], -1
    )
    points = np.concatenate([places + noise * random.normal(size=places.shape), np.full((count, 33, 1), 0.8)], -1)
    return FollowedPerson(np.arange(count), points, points[..., 2].copy(), np.full(count, 400.0), ())


def test_a_point_that_jumps_for_one_picture_is_not_believed_and_nothing_else_is_touched():
    person = moving()
    person.points[12, 7, :2] += (60, 20)
    person.points[20, 9, :2] += (-45, 0)
    lowered = believed(person, (900, 900)).points[..., 2] == 0
    assert np.argwhere(lowered).tolist() == [[12, 7], [20, 9]]


def test_fast_movement_and_a_jump_that_lasts_are_believed():
    person = moving(noise=3.0)
    person.points[15:, 4, :2] += (80, 0)
    person.points[:, 5, 0] += 100 * np.sin(np.arange(30))
    assert (believed(person, (2000, 2000)).points[..., 2] > 0).all()


def test_neighbours_in_time_are_those_of_the_next_picture_only():
    """Frames 5 and 90 are no neighbours; nor is a person who was not found."""
    person = moving(12)
    frames = np.array([0, 1, 2, 3, 4, 5, 90, 91, 92, 93, 94, 95])
    person.points[6:, :, 0] += 70
    person.points[9] = 0.0
    person.scores[9], person.sides[9] = 0.0, 0.0
    one = FollowedPerson(frames, person.points, person.scores, person.sides, ())
    assert (believed(one, (900, 900)).points[..., 2] > 0).sum() == 11 * 33


def test_a_person_s_file_is_read_again_and_by_the_reader_of_all_files(tmp_path):
    person = moving(4)
    person.points[2] = 0.0
    person.scores[2], person.sides[2] = 0.0, 0.0
    person.points[1, 11, 2] = 0.0
    person = FollowedPerson(np.array([7, 8, 9, 12]), person.points, person.scores, person.sides, ())
    write_person(tmp_path / "cam0.json", person)
    again = read_person(tmp_path / "cam0.json")
    assert again.frames.tolist() == [7, 8, 9, 12]
    np.testing.assert_allclose(again.points, person.points, atol=0.006)
    np.testing.assert_allclose(again.scores, person.scores, atol=0.001)
    people = read_video(tmp_path / "cam0.json")
    assert {frame: len(found) for frame, found in people.items()} == {7: 1, 8: 1, 9: 0, 12: 1}
    assert people[7][0][5] == pytest.approx(person.points[0, 11], abs=0.006)  # the left shoulder
    assert people[8][0][5, 2] == 0
    (tmp_path / "cam0.json").write_text("[]x")
    with pytest.raises(InputError, match=r"cam0.json is not as detect wrote it .*; remove it and detect again"):
        read_person(tmp_path / "cam0.json")


def test_pictures_looked_at_later_are_added_in_order():
    first, later = moving(6), moving(6)
    later = FollowedPerson(np.arange(4, 10), later.points + 1, later.scores, later.sides, ("a note",))
    both = first.joined(later)
    assert both.frames.tolist() == list(range(10))
    np.testing.assert_array_equal(both.points[3], first.points[3])
    np.testing.assert_array_equal(both.points[4], later.points[0])
    assert both.notes == ("a note",)
