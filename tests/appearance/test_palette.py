import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmocap.appearance import (
    ColourSettings,
    fit_colour_models,
    fit_palette,
    label_image,
    palette_from_colours,
    psi,
    psi_table,
)


def scene(rng, elements=30, pixels=400):
    """Elements with two colours each, and noise."""
    ids = np.repeat(np.arange(elements), pixels)
    centres = rng.random((elements, 2, 3))
    colours = centres[ids, rng.integers(0, 2, len(ids))] + rng.normal(size=(len(ids), 3)) * 0.03
    return ids, np.clip(colours, 0, 1).astype(np.float32)


def test_labels_are_nearest_to_within_the_lattice():
    rng = np.random.default_rng(0)
    palette = palette_from_colours(rng.random((200, 3)))
    image = rng.integers(0, 256, (40, 50, 3)).astype(np.uint8)
    labels = label_image(palette, image)
    colours = np.asarray(palette.colours)
    distances = np.linalg.norm(image[..., None, :] / 255 - colours, axis=-1)
    chosen = np.take_along_axis(distances, labels[..., None].astype(int), axis=-1)[..., 0]
    assert (chosen <= distances.min(axis=-1) + 2 * np.sqrt(3) / 128 + 0.01).all()


def test_labels_of_numpy_jax_bytes_and_floats_agree():
    rng = np.random.default_rng(1)
    palette = palette_from_colours(rng.random((100, 3)))
    image = rng.integers(0, 256, (20, 30, 3)).astype(np.uint8)
    labels = label_image(palette, image)
    np.testing.assert_array_equal(labels, jax.jit(label_image)(palette, jnp.asarray(image)))
    as_float = (image.astype(np.float32) + 0.5) / 256
    np.testing.assert_array_equal(labels, label_image(palette, as_float))
    white = label_image(palette, np.full((1, 3), 255, np.uint8))
    np.testing.assert_array_equal(label_image(palette, np.ones((1, 3), np.float32)), white)


def test_the_palette_is_deterministic_and_has_every_colour_of_a_poor_image():
    rng = np.random.default_rng(2)
    pixels = rng.integers(0, 256, (5000, 3)).astype(np.uint8)
    first, second = fit_palette(pixels, 64), fit_palette(pixels, 64)
    np.testing.assert_array_equal(first.colours, second.colours)
    assert first.colours.shape == (64, 3)
    poor = np.repeat(np.array([[0, 0, 0], [255, 0, 0], [0, 255, 255]], np.uint8), 50, axis=0)
    found = np.asarray(fit_palette(poor, 64).colours)
    np.testing.assert_allclose(sorted(found.tolist()), [[0, 0, 0], [0, 1, 1], [1, 0, 0]], atol=1e-6)


def test_the_table_is_psi_at_the_palette_colours_even_for_tiny_floors():
    ids, colours = scene(np.random.default_rng(3))
    model = fit_colour_models(ids, colours, 31, key=jax.random.key(0))
    palette = fit_palette(colours, 128)
    for settings in (ColourSettings(), ColourSettings(s0=0.001, kappa=1), ColourSettings(metric="euclidean")):
        table = psi_table(model, palette, settings, jnp.float32)
        elements, entries = jnp.meshgrid(jnp.arange(31), jnp.arange(128), indexing="ij")
        exact = psi(model, elements, palette.colours[entries], settings)
        np.testing.assert_allclose(table, exact, atol=1e-4)
    assert (np.asarray(table[30]) == 1).all()
    half = psi_table(model, palette)
    assert half.dtype == jnp.float16
    np.testing.assert_allclose(half, psi_table(model, palette, None, jnp.float32), atol=1e-3)


@pytest.mark.slow
def test_the_table_error_falls_with_the_palette_and_stays_below_the_bound():
    rng = np.random.default_rng(4)
    ids, colours = scene(rng)
    model = fit_colour_models(ids, colours, 30, key=jax.random.key(0))
    others = rng.integers(0, 30, len(ids))

    def error(elements, size):
        palette = fit_palette(colours, size)
        table = np.asarray(psi_table(model, palette, None, jnp.float32))
        return table[elements, label_image(palette, colours)] - psi(model, elements, jnp.asarray(colours))

    coarse, fine, own = error(others, 64), error(others, 1024), error(ids, 1024)
    assert np.mean(fine**2) < 0.25 * np.mean(coarse**2)
    assert np.sqrt(np.mean(fine**2)) < 0.03
    assert abs(np.mean(fine)) < 0.005
    assert np.sqrt(np.mean(own**2)) < 0.05
    assert np.percentile(np.abs(own), 95) < 0.1
