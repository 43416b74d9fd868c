"""The clean plate of a filmed sequence: it grows with every frame, and it tells the person from the background."""

import threading
from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from jaxmocap.appearance import AppearanceSettings, Plate, plate_beside
from jaxmocap.observation._clean_plate import CleanPlate, neighbour_warp
from jaxmocap.observation._flow import FlowAhead, frame_flow

SETTINGS = AppearanceSettings(behind="plate")


@pytest.fixture(scope="module")
def texture() -> np.ndarray:
    noise = np.random.default_rng(1).uniform(size=(240, 320, 3))
    rough = np.stack([gaussian_filter(noise[..., c], 2.0) for c in range(3)], -1)
    return (255 * (rough - rough.min()) / np.ptp(rough)).astype(np.uint8)


def disc(x: int, y: int, radius: int = 25) -> np.ndarray:
    row, column = np.mgrid[:240, :320]
    return (column - x) ** 2 + (row - y) ** 2 < radius**2


def filmed(texture: np.ndarray, frame: int) -> tuple[np.ndarray, np.ndarray]:
    """A camera that drifts 2 pixels per frame, and a red disc that moves 12."""
    person = disc(110 + 12 * frame, 120)
    image = np.roll(texture, 2 * frame, axis=1)
    return np.where(person[..., None], np.uint8([250, 0, 0]), image), person


def test_the_neighbour_is_found_to_a_tenth_of_a_pixel(texture):
    (before, person), (after, person_after) = filmed(texture, 0), filmed(texture, 1)
    warp = neighbour_warp(frame_flow(before, after), person, person_after, SETTINGS)
    middle = (np.abs(warp.vertices - (160, 120)) < (110, 90)).all(axis=1)
    regular = np.stack(np.meshgrid(np.linspace(0, 320, 17), np.linspace(0, 240, 17)), -1).reshape(-1, 2)
    assert middle.sum() > 80
    np.testing.assert_allclose((warp.vertices - regular)[middle], [[2.0, 0.0]] * middle.sum(), atol=0.1)


def test_what_the_person_uncovers_is_learnt_and_told_from_the_person(texture):
    window = (slice(40, 200), slice(40, 300))
    image, person = filmed(texture, 0)
    state = CleanPlate(SETTINGS, 0, plate_beside(image, person, SETTINGS.plate), image, person)
    unknown = [(~state.plate.known[window]).sum()]
    for frame in range(1, 6):
        state = state.learnt(person, window)
        image, expected = filmed(texture, frame)[0], person
        state = state.at(frame, image, expected)
        person = filmed(texture, frame)[1]
        unknown.append((~state.plate.known[window]).sum())
        distance = state.distance(window)
        seen = person[window] & state.plate.known[window]
        assert distance[seen].min() > 0.9
        assert np.median(distance[~person[window]]) < 0.05
    assert unknown[-1] < 0.35 * unknown[0]
    here = disc(110, 120, 15)[window] & state.plate.known[window]
    truth = np.roll(texture, 10, axis=1)[window].astype(int)
    assert np.abs(state.plate.picture[window].astype(int) - truth)[here].mean() < 6


def test_a_frame_asked_for_twice_gives_the_same_plate(texture):
    image, person = filmed(texture, 0)
    state = CleanPlate(SETTINGS, 0, plate_beside(image, person, SETTINGS.plate), image, person)
    learnt = state.learnt(person, (slice(0, 240), slice(0, 320)))
    window = (slice(40, 200), slice(40, 300))
    np.testing.assert_array_equal(learnt.at(0, image, person).distance(window), state.distance(window))
    assert isinstance(learnt.renewed, Plate)


def test_a_filmed_person_stands_out_from_the_first_frame_on(world):
    appearance = replace(world.appearance, settings=replace(world.appearance.settings, behind="plate"))
    observations = replace(world.observations(), appearance=appearance)
    cold = np.asarray(observations.problem(world.shown(2), world.rectangle(2), world.pose(2)).background)
    known = observations.background.start()
    for number in (0, 1):
        given = world.shown(number), world.rectangle(number), world.pose(number)
        _, known = observations.observe(*given, known)
        known = observations.background.learn(known, *given)
    frame, _ = observations.observe(world.shown(2), world.rectangle(2), world.pose(2), known)
    warm = np.asarray(frame.problem.background)
    masks, unknown = world.masks(2), float(appearance.settings.plate.unknown)
    for background in (cold, warm):
        known = background != unknown
        assert np.median(background[~masks & known]) < 0.05
        assert background[masks & known].mean() > 0.8
    again = np.asarray(observations.problem(world.shown(2), world.rectangle(2), world.pose(2)).background)
    np.testing.assert_array_equal(again, cold)


def test_flow_computed_ahead_is_that_of_the_same_images_and_of_no_others(texture, monkeypatch):
    computed_here = []

    def spied(before, after):
        if threading.current_thread() is threading.main_thread():
            computed_here.append(before)
        return frame_flow(before, after)

    monkeypatch.setattr("jaxmocap.observation._flow.frame_flow", spied)
    frames = [[filmed(texture, n)[0], filmed(texture, 2 * n)[0]] for n in range(4)]
    ahead = FlowAhead()
    for number, images in enumerate(ahead.follow(frames, lambda images: images)):
        assert images is frames[number]
        for camera in range(2) if number else ():
            pair = frames[number - 1][camera], frames[number][camera]
            for asked, late in ((pair, 0), ([image.copy() for image in pair], 1), (pair[::-1], 1)):
                computed_here.clear()
                found = ahead.between(camera, *asked)
                assert len(computed_here) == late
                for computed, plain in zip(found, frame_flow(*asked), strict=True):
                    np.testing.assert_array_equal(computed, plain)
    assert number == 3


def test_a_frame_that_cannot_be_decoded_fails_after_the_one_before_it(texture):
    def decoded():
        yield [texture]
        yield [texture]
        raise OSError("damaged")

    passed = []
    with pytest.raises(OSError, match="damaged"):
        passed.extend(FlowAhead().follow(decoded(), lambda images: images))
    assert len(passed) == 2
