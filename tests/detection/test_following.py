"""Following a drawn person, whose networks read marks: the answer is known to a fraction of a pixel."""

from dataclasses import replace

import numpy as np
import pytest
from marked_person import MODEL, SIZE, answer, draw, find_marks, read_marks

from jaxmocap.detection import LAYOUTS, Region, Sighting, follow_person
from jaxmocap.detection._blazepose import BlazePose
from jaxmocap.detection._left_right import mirrored_points
from jaxmocap.detection._region import brightened

TURNS = np.linspace(-1.2, 2.5, 15)


def walk(count: int = 15, length: float = 45.0, shift: float = 0.0):
    """Hips and head of a person who crosses the picture and turns upside down on the way."""
    hips = np.stack([np.linspace(120, 190, count) + shift, 120 + 15 * np.sin(np.arange(count) / 3)], axis=1)
    turns = np.interp(np.arange(count), np.arange(15), TURNS)
    return hips, hips + length * np.stack([np.sin(turns), -np.cos(turns)], axis=1)


def errors(found, hips, head):
    return np.array(
        [np.abs(points[:, :2] - answer(*place)).max() for points, *place in zip(found.points, hips, head, strict=True)]
    )


@pytest.mark.parametrize("level", [255, 40])
def test_a_person_who_moves_and_turns_is_followed_to_the_pixel_in_light_and_dark(level):
    hips, head = walk()
    found = follow_person([draw(place, level=level) for place in zip(hips, head, strict=True)], MODEL)
    assert found.found.all()
    assert errors(found, hips, head).max() < 0.7
    assert found.notes == ()
    assert (found.points[..., 2] > 0.9).all()


def test_a_mirror_image_whose_sides_are_exchanged_does_not_draw_the_points_to_the_middle():
    """The mean of both answers lay on one line, and then the sides were exchanged for a while."""

    def confused(pictures):
        values, *rest = read_marks(pictures)
        values = values.reshape(-1, 39, 5)
        values[1, :33] = values[1, mirrored_points(LAYOUTS["blazepose33"])]
        return [values.reshape(-1, 195), *rest]

    hips, head = walk()
    pictures = [draw(place) for place in zip(hips, head, strict=True)]
    found = follow_person(pictures, BlazePose(find_marks, confused))
    assert errors(found, hips, head).max() < 0.7


def test_of_several_people_the_largest_or_the_one_pointed_at_is_followed_and_said():
    one, other = walk(6, 40.0, -70.0), walk(6, 28.0, 80.0)
    pictures = [draw(*people) for people in zip(zip(*one, strict=True), zip(*other, strict=True), strict=True)]
    found = follow_person(pictures, MODEL)
    assert errors(found, *one).max() < 0.7
    x, y = one[0][0]
    assert len(found.notes) == 1
    assert found.notes[0].startswith(f"2 people: the largest, at ({x:.0f}, {y:.0f}), is followed, not those at (")
    chosen = follow_person(pictures, MODEL, at=tuple(other[0][0] + 5))
    assert errors(chosen, *other).max() < 0.7
    assert "the one chosen" in chosen.notes[0]


def test_a_person_who_was_hidden_is_found_again_and_not_mistaken_for_another():
    one, other = walk(9, 40.0, -80.0), walk(9, 30.0, 110.0)
    people = [list(row) for row in zip(zip(*one, strict=True), zip(*other, strict=True), strict=True)]
    for frame in (3, 4):
        people[frame] = people[frame][1:]
    found = follow_person([draw(*row) for row in people], MODEL, frames=range(100, 109))
    assert found.frames.tolist() == list(range(100, 109))
    assert found.found.tolist() == [True] * 3 + [False] * 2 + [True] * 4
    assert errors(found, *one)[found.found].max() < 0.7
    assert (found.points[3:5] == 0).all()


def test_pictures_without_anybody_give_nothing():
    found = follow_person([draw(), draw()], MODEL)
    assert found.points.shape == (2, 0, 3)
    assert not found.found.any()


def test_a_small_person_is_found_in_a_quarter_of_the_picture():
    """Spots are lost when the whole picture is made as small as the network's."""
    hips, head = np.array([150.0, 1300.0]), np.array([150.0, 1230.0])
    picture = np.full((1800, 2400, 3), 40, np.uint8)
    picture[1200:1440, 0:320] = draw((hips - [0, 1200], head - [0, 1200]), radius=6)
    assert MODEL.find(picture, thorough=False) == []
    (region,) = MODEL.find(picture)
    assert np.hypot(*(np.array(region.centre) - hips)) < 4
    assert region.side == pytest.approx(175, rel=0.1)


def test_points_outside_the_picture_are_not_believed():
    place = np.array([5.0, 120.0]), np.array([5.0, 30.0])
    found = follow_person([draw(place)], MODEL)
    beyond = answer(*place)[:, 0] < -1
    inside = answer(*place)[:, 0] > 1
    assert beyond.any()
    assert (found.points[0, beyond, 2] == 0).all()
    assert (found.points[0, inside, 2] > 0.9).all()
    assert (found.scores[0] > 0.9).all()


class Contrary:
    """A model that sees a turned person the wrong way round in some pictures, and says so neither in its presence nor
    by doubting."""

    def __init__(self, wrong):
        self.wrong, self.frame = wrong, -1

    def find(self, picture, part=None, *, thorough=True):
        return MODEL.find(picture, part, thorough=thorough)

    def look(self, picture, region):
        sighting = MODEL.look(picture, region)
        if int(picture[0, 0, 2]) in self.wrong and abs(region.angle) > 0.1:
            hips = sighting.points[:, :2].mean(0)
            turned = sighting.points * (-1, -1, 1) + (*(2 * hips), 0)
            return Sighting(turned, sighting.presence, region)
        return sighting


def test_an_answer_that_jumps_is_asked_for_again_in_a_square_that_is_turned_otherwise():
    hips, head = np.tile([160.0, 120.0], (6, 1)), np.tile([185.0, 80.0], (6, 1))
    pictures = [draw(place) for place in zip(hips, head, strict=True)]
    for frame, picture in enumerate(pictures):
        picture[0, 0] = (0, 0, frame)
    found = follow_person(pictures, Contrary({2, 3}))
    assert errors(found, hips, head).max() < 0.7


class Stubborn(Contrary):
    """A model that is wrong about the first picture, and then in every square like the one it made of it."""

    def look(self, picture, region):
        sighting = MODEL.look(picture, region)
        if int(picture[0, 0, 2]) == 0 or region.side > 150:
            shifted = sighting.points + (30, 20, 0)
            return Sighting(shifted, sighting.presence, replace(sighting.region, side=160.0))
        return sighting


def test_a_mistake_that_is_followed_ends_when_the_person_is_found_anew():
    hips, head = np.tile([160.0, 120.0], (16, 1)), np.tile([175.0, 78.0], (16, 1))
    pictures = [draw(place) for place in zip(hips, head, strict=True)]
    for frame, picture in enumerate(pictures):
        picture[0, 0] = (0, 0, frame)
    wrong = errors(follow_person(pictures, Stubborn(())), hips, head)
    assert (wrong[:12] > 20).all()
    assert (wrong[12:] < 0.7).all()


def test_a_person_found_upside_down_too_is_one_person():
    class Twice(Contrary):
        def find(self, picture, part=None, *, thorough=True):
            (region,) = MODEL.find(picture, part, thorough=thorough)
            return [replace(region, angle=np.pi, side=1.2 * region.side), region][: 2 - self.late]

        late = 0

        def look(self, picture, region):
            sighting = MODEL.look(picture, region)
            if np.cos(region.angle) > 0:
                return sighting
            turned = replace(sighting.region, angle=np.pi)
            return Sighting(sighting.points + (0, 40, 0), sighting.presence, turned)

    place = np.array([160.0, 120.0]), np.array([160.0, 78.0])

    def pictures(model):
        for frame in range(15):
            model.late = int(frame > 0)  # then it is found upside down only
            yield draw(place)

    model = Twice(())
    found = follow_person(pictures(model), model)
    assert found.notes == ()
    assert errors(found, *([one] * 15 for one in place)).max() < 0.7


def test_a_region_cuts_the_picture_where_it_says():
    region = Region((100.0, 80.0), 64.0, 0.6)
    place = region.to_picture(np.array([[0.25, 0.75]]))[0]
    picture = np.zeros((200, 200, 3), np.uint8)
    import cv2

    cv2.circle(picture, tuple(np.rint((place - 0.5) * 16).astype(int).tolist()), 2 * 16, (255,) * 3, -1, cv2.LINE_AA, 4)
    for size in (64, 256, 24):
        cut = region.cut(picture, size).astype(float)[..., 0]
        rows, columns = np.mgrid[:size, :size] + 0.5
        middle = np.array([(cut * columns).sum(), (cut * rows).sum()]) / cut.sum() / size
        assert middle == pytest.approx([0.25, 0.75], abs=0.3 / 24)
    assert region.holds(*place)
    assert not region.holds(100.0 + 64, 80.0)


def test_dark_pictures_are_brightened_and_bright_ones_left_alone():
    rng = np.random.default_rng(0)
    dark = rng.integers(1, 60, (40, 40, 3)).astype(np.uint8)
    assert 85 < brightened(dark).mean() < 125
    bright = rng.integers(60, 250, (40, 40, 3)).astype(np.uint8)
    assert brightened(bright) is bright
    half = np.zeros((40, 80, 3), np.uint8)
    half[:, :40] = bright
    assert brightened(half) is half


def test_silhouettes_are_told_with_the_number_of_their_picture_and_lie_where_the_person_is():
    """The person turns, and the square with them: the disc about the hips is found to a pixel at its outline."""
    hips, head = walk(6)
    told: dict[int, np.ndarray] = {}
    pictures = [draw(place) for place in zip(hips, head, strict=True)]
    found = follow_person(pictures, MODEL, frames=range(40, 46), silhouette=told.__setitem__)
    assert sorted(told) == found.frames.tolist()
    rows, columns = np.mgrid[: SIZE[1], : SIZE[0]] + 0.5
    for number, place in enumerate(hips):
        distance = np.hypot(columns - place[0], rows - place[1])
        mask = told[40 + number]
        assert mask.shape == distance.shape
        assert mask[distance < 22.5 - 1.2].all()
        assert not mask[distance > 22.5 + 1.2].any()
