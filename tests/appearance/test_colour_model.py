import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmocap._results import InputError
from jaxmocap.appearance import TAU, ColourModel, ColourSettings, fit_colour_models, psi


def symmetric(six):
    rr, rg, rb, gg, gb, bb = six
    return np.array([[rr, rg, rb], [rg, gg, gb], [rb, gb, bb]], np.float64)


@pytest.fixture
def model():
    rng = np.random.default_rng(0)
    roots = rng.normal(size=(4, 5, 3, 3)) * 0.08
    full = roots @ roots.transpose(0, 1, 3, 2)
    six = np.stack([full[..., i, j] for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))], axis=-1)
    count = np.array([5, 3, 1, 5])
    weights = np.where(np.arange(5) < count[:, None], 1.0 / count[:, None], 0.0)
    return ColourModel(
        jnp.asarray(rng.random((4, 5, 3)), jnp.float32),
        jnp.asarray(six, jnp.float32),
        jnp.asarray(weights, jnp.float32),
        jnp.array([True, True, True, False]),
        jnp.asarray(count),
    )


def direct_psi(model, element, colour, settings):
    """Eq. 3 with the floor, written out cluster by cluster."""
    if element < 0 or not bool(model.valid[element]):
        return TAU
    distances = [TAU]
    for k in range(int(model.cluster_count[element])):
        difference = np.asarray(colour, np.float64) - np.asarray(model.means[element, k], np.float64)
        if settings.metric == "euclidean":
            distances.append(np.sqrt(difference @ difference))
            continue
        covariance = symmetric(np.asarray(model.covariances[element, k]))
        if settings.covariance == "diag":
            covariance = np.diag(np.diag(covariance))
        if settings.covariance == "iso":
            covariance = np.eye(3) * np.trace(covariance) / 3
        inverse = np.linalg.inv(covariance + float(settings.s0) ** 2 * np.eye(3))
        distance = difference @ inverse @ difference / float(settings.kappa)
        if settings.weights == "neglog":
            distance -= 2 * np.log(float(model.weights[element, k])) / float(settings.kappa)
        distances.append(distance)
    return min(distances)


@pytest.mark.parametrize(
    "settings",
    [
        ColourSettings(),
        ColourSettings(s0=0.15, kappa=1),
        ColourSettings(covariance="diag"),
        ColourSettings(covariance="iso"),
        ColourSettings(metric="euclidean"),
        ColourSettings(weights="neglog"),
    ],
    ids=["default", "literal", "diag", "iso", "euclidean", "neglog"],
)
def test_psi_is_the_direct_formula(model, settings):
    rng = np.random.default_rng(1)
    ids = np.concatenate([rng.integers(0, 4, 200), [-1, -1]])
    near = np.asarray(model.means)[np.maximum(ids, 0), rng.integers(0, 5, len(ids))]
    colours = (near + rng.normal(size=near.shape) * 0.1).astype(np.float32)
    expected = [direct_psi(model, e, c, settings) for e, c in zip(ids, colours, strict=True)]
    np.testing.assert_allclose(psi(model, jnp.asarray(ids), jnp.asarray(colours), settings), expected, atol=2e-5)


def test_elements_without_a_model_stay_at_the_barrier(model):
    ids = jnp.array([3, -1])
    np.testing.assert_array_equal(psi(model, ids, model.means[3, :2]), [1.0, 1.0])


def test_colours_of_eight_bits_are_refused(model):
    with pytest.raises(InputError, match=r"type uint8; RGB in .* divide 8 bits by 255"):
        psi(model, np.zeros(2, int), np.zeros((2, 3), np.uint8))


def test_psi_gradients_agree_with_finite_differences(model):
    settings = ColourSettings()
    ids = jnp.array([0, 1, 2, 0])
    colours = model.means[ids, 0] + 0.05

    def total(colours, s0):
        changed = eqx.tree_at(lambda s: s.s0, settings, s0)
        return jnp.sum(psi(model, ids, colours, changed))

    by_colour, by_floor = jax.grad(total, argnums=(0, 1))(colours, settings.s0)
    step = 1e-3
    along = jax.random.normal(jax.random.key(0), colours.shape)
    numeric = (total(colours + step * along, settings.s0) - total(colours - step * along, settings.s0)) / (2 * step)
    assert jnp.abs(jnp.sum(by_colour * along) - numeric) < 2e-2 * jnp.abs(numeric)
    numeric = (total(colours, settings.s0 + step) - total(colours, settings.s0 - step)) / (2 * step)
    assert jnp.abs(by_floor - numeric) < 2e-2 * jnp.abs(numeric)


def test_the_euclidean_metric_has_a_finite_gradient_at_a_mean(model):
    settings = ColourSettings(metric="euclidean")
    slope = jax.grad(lambda c: jnp.sum(psi(model, jnp.array([0]), c, settings)))(model.means[0, :1])
    assert jnp.isfinite(slope).all()


def test_the_printed_reading_puts_eighty_percent_of_own_pixels_at_the_barrier_and_ours_hardly_any():
    rng = np.random.default_rng(2)
    pixels = np.clip(0.5 + rng.normal(size=(4000, 3)) * 0.03, 0, 1).astype(np.float32)
    settings = ColourSettings(clusters=1)
    model = fit_colour_models(np.zeros(2000, int), pixels[:2000], 1, key=jax.random.key(0), settings=settings)
    held_out = jnp.asarray(pixels[2000:])
    ids = jnp.zeros(2000, int)
    printed = psi(model, ids, held_out, ColourSettings(s0=1e-4, kappa=1))
    assert 0.77 < float(jnp.mean(printed >= 1.0)) < 0.83
    ours = psi(model, ids, held_out)
    assert float(jnp.mean(ours >= 1.0)) < 0.001
    assert float(jnp.mean(ours)) < 0.1
