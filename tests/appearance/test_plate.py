"""The clean plate: pictures of known content, so that every distance can be said beforehand."""

from types import SimpleNamespace

import jax
import numpy as np
import pytest

from jaxmocap.appearance import (
    GridSettings,
    Plate,
    PlateSettings,
    background_distance,
    fit_background,
    fit_palette,
    grid_vertices,
    label_image,
    plate_beside,
    plate_distance,
    psi_table,
    renewed_plate,
    warp_grid,
    warped_plate,
)

HEIGHT, WIDTH = 160, 200
EVERYTHING = (slice(0, HEIGHT), slice(0, WIDTH))


def everywhere(picture) -> Plate:
    return Plate(picture, np.ones(picture.shape[:2], bool))


def box(top: int, left: int, size: int) -> np.ndarray:
    mask = np.zeros((HEIGHT, WIDTH), bool)
    mask[top : top + size, left : left + size] = True
    return mask


@pytest.fixture
def bricks() -> np.ndarray:
    """Two colours in tiles of 12 pixels, laid at random."""
    tiles = np.random.default_rng(0).integers(0, 2, (HEIGHT // 12 + 1, WIDTH // 12 + 1))
    pattern = np.kron(tiles, np.ones((12, 12), int))[:HEIGHT, :WIDTH]
    return np.where(pattern[..., None], np.uint8([190, 150, 120]), np.uint8([120, 100, 90]))


def test_the_distance_is_the_squared_colour_difference():
    plain = np.full((HEIGHT, WIDTH, 3), 100, np.uint8)
    other = plain + np.uint8([0, 9, 0])
    expected = (9 / 255 / 0.1) ** 2
    np.testing.assert_allclose(plate_distance(everywhere(plain), other), expected, rtol=1e-4)
    np.testing.assert_allclose(plate_distance(everywhere(plain), plain + np.uint8(80)), 1.0)
    np.testing.assert_allclose(
        plate_distance(everywhere(plain), other, PlateSettings(s0=0.05)), 4 * expected, rtol=1e-4
    )


@pytest.mark.parametrize("shift", [0, 2, -2, 4])
def test_a_picture_may_be_off_by_the_reach(bricks, shift):
    settings = PlateSettings(blur=0.0, reach=2)
    distance = plate_distance(everywhere(bricks), np.roll(bricks, shift, axis=1), settings)[:, 8:-8]
    if abs(shift) <= 2:
        assert distance.max() == 0.0
    else:
        assert (distance > 0.5).mean() > 0.05


def test_camouflage_is_seen_where_colour_models_are_blind(bricks):
    """A patch in the background's own colours, laid another way."""
    patch = box(48, 72, 48)
    seen = np.where(patch[..., None], np.roll(bricks, (60, 36), axis=(0, 1)), bricks)
    grid = GridSettings(rows=4, columns=4)
    model = fit_background(bricks, None, key=jax.random.key(0), grid=grid)
    still = warp_grid(np.zeros((0, 2)), np.zeros((0, 2)), (HEIGHT, WIDTH), grid=grid)
    palette = fit_palette(bricks)
    table = np.asarray(psi_table(model.colours, palette))
    blind = background_distance(table, still, label_image(palette, seen), grid=grid)
    sharp = plate_distance(everywhere(bricks), seen)
    assert blind[patch].mean() < 0.05
    assert sharp[patch].mean() > 0.3 > 0.01 > sharp[~patch].mean()


def test_what_nobody_has_seen_is_neutral(bricks):
    plate = plate_beside(bricks, box(60, 60, 20), PlateSettings(growth=4))
    assert not plate.known[56:84, 66:74].any()
    assert plate.known[~box(55, 55, 30)].all()
    distance = plate_distance(plate, 255 - bricks, PlateSettings(unknown=0.4))
    np.testing.assert_allclose(distance[~plate.known], 0.4)


def test_a_carried_plate_follows_its_grid_to_the_pixel(bricks):
    moved = grid_vertices(HEIGHT, WIDTH) + (7, -3)
    plate = plate_beside(bricks, box(60, 60, 20), PlateSettings(growth=0))
    carried = warped_plate(plate, SimpleNamespace(vertices=moved, rest=moved))
    np.testing.assert_array_equal(carried.picture[: HEIGHT - 3, 7:], bricks[3:, : WIDTH - 7])
    np.testing.assert_array_equal(carried.known[4 : HEIGHT - 5, 10:-2], plate.known[7 : HEIGHT - 2, 3 : WIDTH - 9])
    assert not carried.known[:, :6].any()


def test_plates_complete_each_other(bricks):
    first, second = (plate_beside(bricks, box(60, left, 30), PlateSettings(growth=0)) for left in (60, 80))
    both = first.filled_from(Plate(second.picture // 2, second.known))
    np.testing.assert_array_equal(both.known, ~(box(60, 60, 30) & box(60, 80, 30)))
    np.testing.assert_array_equal(both.picture[first.known], bricks[first.known])
    np.testing.assert_array_equal(both.picture[box(60, 60, 20)], bricks[box(60, 60, 20)] // 2)


def test_a_frame_renews_all_but_the_person_and_what_looks_foreign(bricks):
    person, limb, shadow, far = box(60, 60, 20), box(60, 100, 16), box(100, 60, 20), box(20, 160, 20)
    window = (slice(40, 140), slice(40, 150))
    seen = bricks.copy()
    seen[person] = seen[limb] = [20, 20, 220]
    seen[far] = [20, 220, 20]
    seen[shadow] = (0.5 * bricks[shadow]).astype(np.uint8)
    plate = renewed_plate(everywhere(bricks), seen, person, window, PlateSettings(blur=0.0))
    for hidden in (person, limb):
        np.testing.assert_array_equal(plate.picture[hidden], bricks[hidden])
    for learnt in (shadow, far):
        np.testing.assert_array_equal(plate.picture[learnt], seen[learnt])
    unseen = renewed_plate(Plate(bricks, ~person), seen, box(60, 90, 20), window, PlateSettings(blur=0.0, growth=0))
    np.testing.assert_array_equal(unseen.picture[person], seen[person])
    assert unseen.known.all()


def test_without_shadows_a_darker_place_stays_foreign(bricks):
    shadow = box(100, 60, 20)
    seen = np.where(shadow[..., None], (0.5 * bricks).astype(np.uint8), bricks)
    settings = PlateSettings(blur=0.0, reach=0, shadow_low=1.0, shadow_high=1.0)
    plate = renewed_plate(everywhere(bricks), seen, box(0, 0, 1), EVERYTHING, settings)
    np.testing.assert_array_equal(plate.picture[shadow], bricks[shadow])
