import jax
import numpy as np
import pytest

from jaxmocap.appearance import (
    AppearanceSettings,
    ColourSettings,
    ForegroundSettings,
    GridSettings,
    WarpSettings,
    background_distance,
    fit_appearance,
    label_image,
    psi,
    warp_grid,
)

FACES = np.array([[0, 1, 2], [2, 1, 3], [2, 3, 4], [4, 3, 5]])
SETTINGS = AppearanceSettings(
    colour=ColourSettings(s0=0.06, covariance="diag"),
    grid=GridSettings(rows=6, columns=8, blend="min"),
    warp=WarpSettings(alphas=(0.1, 1.0)),
    foreground=ForegroundSettings(pool_ring=0),
    palette_size=200,
)


@pytest.fixture(scope="module")
def scene(street):
    """Two cameras and two selected frames of the same street; the person's mask is cut into three triangles."""
    image, mask = street
    ids = np.where(mask, np.clip((np.mgrid[:120, :160][0] - 20) // 27, 0, 2), -1)
    facing = np.array([1.0, 0.9, 0.8, 1.0])
    return [[ids, ids]] * 2, [[image, image[:, ::-1]]] * 2, [[facing, facing]] * 2, [[mask, mask]] * 2


@pytest.fixture(scope="module")
def appearance(scene):
    ids, images, facing, masks = scene
    return fit_appearance(ids, images, facing, FACES, (0, 10), masks=masks, key=jax.random.key(0), settings=SETTINGS)


def test_every_model_has_its_axes(appearance):
    assert appearance.foreground.colours.means.shape == (2, 4, 5, 3)
    assert appearance.background.colours.means.shape == (2, 2, 96, 5, 3)
    assert appearance.sizes == ((160, 120), (160, 120))
    assert appearance.selected_for(4) == (0, 1)
    np.testing.assert_array_equal(appearance.foreground.colours.valid, [[True, True, True, False]] * 2)
    assert appearance.background_table(1, 0).shape == (96, len(appearance.palette.colours))


def test_person_and_background_are_told_apart(appearance, street):
    image, mask = street
    labels = label_image(appearance.palette, image)
    still = warp_grid(np.zeros((0, 2)), np.zeros((0, 2)), (120, 160), grid=SETTINGS.grid)
    behind = background_distance(np.asarray(appearance.background_table(0, 1)), still, labels, grid=SETTINGS.grid)
    front = np.asarray(appearance.foreground_table(0))[0][labels]
    assert behind[mask].mean() > 0.95
    assert front[mask].mean() < 0.05
    assert behind[~mask].mean() < 0.1
    assert front[~mask].mean() > 0.9


def test_a_missing_mask_is_replaced_by_the_rendered_silhouette(scene, appearance):
    ids, images, facing, _ = scene
    without = fit_appearance(ids, images, facing, FACES, (0, 10), key=jax.random.key(0), settings=SETTINGS)
    np.testing.assert_array_equal(without.background.source, appearance.background.source)
    np.testing.assert_array_equal(without.foreground.pixel_counts, appearance.foreground.pixel_counts)


def test_models_can_be_swept_over_the_floor_without_fitting_again(appearance):
    colours = np.full((1, 3), [0.9, 0.2, 0.1], np.float32)
    sweep = jax.vmap(lambda s0: psi(appearance.foreground.camera(0), np.zeros(1, int), colours, ColourSettings(s0=s0)))
    values = np.asarray(sweep(np.array([0.02, 0.05, 0.2], np.float32)))[:, 0]
    assert (np.diff(values) < 0).all()
