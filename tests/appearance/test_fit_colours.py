import jax
import jax.numpy as jnp
import numpy as np

from jaxmocap.appearance import ColourSettings, fit_colour_models, psi

KEY = jax.random.key(7)


def leaves_equal(first, second):
    return all(
        bool(jnp.array_equal(a, b)) for a, b in zip(jax.tree.leaves(first), jax.tree.leaves(second), strict=True)
    )


def three_colours(rng, counts=(300, 200, 100), spread=0.01):
    centres = np.array([[0.2, 0.2, 0.8], [0.8, 0.3, 0.2], [0.4, 0.9, 0.4]])
    pixels = np.concatenate([c + rng.normal(size=(n, 3)) * spread for c, n in zip(centres, counts, strict=True)])
    return centres, rng.permutation(pixels).astype(np.float32)


def test_separated_clusters_are_recovered_largest_first():
    centres, pixels = three_colours(np.random.default_rng(0))
    settings = ColourSettings(clusters=3)
    model = fit_colour_models(np.zeros(len(pixels), int), pixels, 1, key=KEY, settings=settings)
    np.testing.assert_allclose(model.means[0], centres, atol=3e-3)
    np.testing.assert_allclose(model.weights[0], [0.5, 1 / 3, 1 / 6], atol=1e-6)
    np.testing.assert_allclose(model.covariances[0], np.tile([1e-4, 0, 0, 1e-4, 0, 1e-4], (3, 1)), atol=4e-5)


def test_means_covariances_and_weights_are_those_of_the_assigned_pixels():
    rng = np.random.default_rng(1)
    pixels = rng.random((400, 3)).astype(np.float32)
    model = fit_colour_models(np.zeros(400, int), pixels, 1, key=KEY)
    means = np.asarray(model.means[0])
    owner = np.argmin(((pixels[:, None] - means) ** 2).sum(-1), axis=1)
    assert int(model.cluster_count[0]) == 5
    for k in range(5):
        own = pixels[owner == k]
        np.testing.assert_allclose(means[k], own.mean(axis=0), atol=5e-3)
        np.testing.assert_allclose(model.weights[0, k], len(own) / 400, atol=0.01)
        covariance = np.cov(own.T, bias=True)[np.triu_indices(3)]
        np.testing.assert_allclose(model.covariances[0, k], covariance, atol=3e-3)
    np.testing.assert_allclose(model.mean_colours()[0], pixels.mean(axis=0), atol=1e-5)


def test_small_elements_get_fewer_clusters_and_unseen_ones_no_model():
    counts = [0, 1, 7, 15, 16, 39, 40, 200]
    ids = np.repeat(np.arange(len(counts)), counts)
    pixels = np.random.default_rng(2).random((len(ids), 3)).astype(np.float32)
    model = fit_colour_models(ids, pixels, len(counts), key=KEY)
    assert model.valid.tolist() == [False] + [True] * 7
    assert int(model.cluster_count[0]) == 0
    assert (np.asarray(model.cluster_count[1:]) <= [1, 1, 1, 2, 4, 5, 5]).all()
    assert (np.asarray(model.cluster_count[1:]) >= 1).all()
    sizes = np.asarray(model.weights) * np.asarray(counts)[:, None]
    assert (sizes[(sizes > 0) & (np.asarray(counts) >= 8)[:, None]] > 7.9).all()
    only_big = fit_colour_models(ids, pixels, len(counts), key=KEY, min_pixels=16)
    assert only_big.valid.tolist() == [False] * 4 + [True] * 4


def test_a_cluster_below_eight_pixels_is_merged_into_its_neighbour():
    rng = np.random.default_rng(3)
    _, pixels = three_colours(rng, counts=(60, 40, 3))
    settings = ColourSettings(clusters=3)
    model = fit_colour_models(np.zeros(len(pixels), int), pixels, 1, key=KEY, settings=settings)
    assert float(model.weights[0].sum()) == 1.0
    sizes = np.asarray(model.weights[0]) * len(pixels)
    assert (sizes[: int(model.cluster_count[0])] >= 8).all()


def test_same_key_same_bits_and_an_element_does_not_depend_on_its_company():
    rng = np.random.default_rng(4)
    ids = rng.integers(0, 50, 6000)
    pixels = rng.random((6000, 3)).astype(np.float32)
    first = fit_colour_models(ids, pixels, 50, key=KEY)
    assert leaves_equal(first, fit_colour_models(ids, pixels, 50, key=KEY))
    alone = fit_colour_models(np.where(ids == 9, 9, -1), pixels, 50, key=KEY)
    np.testing.assert_allclose(alone.means[9], first.means[9], atol=1e-6)
    assert int(alone.valid.sum()) == 1


def test_bytes_and_floats_give_the_same_model():
    rng = np.random.default_rng(5)
    pixels = rng.integers(0, 256, (500, 3)).astype(np.uint8)
    ids = np.zeros(500, int)
    as_float = fit_colour_models(ids, pixels.astype(np.float32) / 255, 1, key=KEY)
    assert leaves_equal(fit_colour_models(ids, pixels, 1, key=KEY), as_float)


def test_more_pixels_than_the_largest_bucket_keep_their_statistics():
    _, pixels = three_colours(np.random.default_rng(6), counts=(3000, 2000, 1000))
    model = fit_colour_models(np.zeros(6000, int), pixels, 1, key=KEY, settings=ColourSettings(clusters=3))
    np.testing.assert_allclose(model.weights[0], [0.5, 1 / 3, 1 / 6], atol=0.04)


def test_identical_pixels_are_one_cluster_at_distance_zero():
    pixels = np.full((100, 3), 0.25, np.float32)
    model = fit_colour_models(np.zeros(100, int), pixels, 1, key=KEY)
    assert int(model.cluster_count[0]) == 1
    assert float(psi(model, jnp.zeros(1, int), jnp.asarray(pixels[:1]))[0]) < 1e-6
