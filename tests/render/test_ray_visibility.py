"""Visibility on a ray through translucent Gaussians: against quadrature, and what must hold of any medium."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad

from jaxmocap.render import on_rays, quantile_samples, transmittance, visibilities

ALONG, SIGMAS, DEPTHS = (
    np.array([3.0, 3.08, 3.11, 3.4]),
    np.array([0.05, 0.04, 0.06, 0.05]),
    np.array([1.5, 0.7, 3.0, 2.0]),
)


def density(at: float, along: float, sigma: float, depth: float) -> float:
    return depth / (np.sqrt(2 * np.pi) * sigma) * np.exp(-0.5 * ((at - along) / sigma) ** 2)


def measured_transmittance(at: float) -> float:
    """The light that is left at a distance, by numerical quadrature of the density along the ray."""
    total = lambda s: sum(density(s, *row) for row in zip(ALONG, SIGMAS, DEPTHS, strict=True))  # noqa: E731
    return np.exp(-quad(total, 0.0, at, points=[a for a in ALONG if a < at] or None, limit=200)[0])


@pytest.fixture(autouse=True)
def _in_double_precision():
    with jax.enable_x64(True):
        yield


def test_the_transmittance_is_the_integral_along_the_ray():
    at = np.array([2.0, 2.95, 3.05, 3.2, 3.6])
    found = transmittance(jnp.asarray(at), jnp.asarray(ALONG), jnp.asarray(SIGMAS), jnp.asarray(DEPTHS))
    np.testing.assert_allclose(found, [measured_transmittance(one) for one in at], atol=1e-9)


@pytest.mark.parametrize(("samples", "most"), [(quantile_samples(4), 0.02), (quantile_samples(12), 2e-3)])
def test_visibilities_are_the_integrals_of_what_is_seen(samples, most):
    seen, behind = visibilities(jnp.asarray(ALONG), jnp.asarray(SIGMAS), jnp.asarray(DEPTHS), samples)
    expected = [
        quad(
            lambda s, row=row: density(s, *row) * measured_transmittance(s),
            row[0] - 8 * row[1],
            row[0] + 8 * row[1],
            epsrel=1e-5,
        )[0]
        for row in zip(ALONG, SIGMAS, DEPTHS, strict=True)
    ]
    np.testing.assert_allclose(seen, expected, atol=most)
    np.testing.assert_allclose(behind, np.exp(-DEPTHS.sum()), atol=1e-9)
    assert float(seen.sum() + behind) == pytest.approx(1.0, abs=2 * most)


def test_a_lone_gaussian_shows_what_it_blocks():
    one = lambda samples: float(visibilities(*(jnp.array([x]) for x in (3.0, 0.05, 3.0)), samples)[0][0])  # noqa: E731
    assert one(quantile_samples(4)) == pytest.approx(1 - np.exp(-3.0), abs=1e-5)


def test_the_nearer_hides_the_farther():
    for order in ((2.0, 3.0), (3.0, 2.0)):
        seen, behind = visibilities(jnp.array(order), jnp.array([0.05, 0.05]), jnp.array([3.0, 3.0]))
        near, far = np.argsort(order)
        assert float(seen[near]) == pytest.approx(1 - np.exp(-3), abs=1e-4)
        assert float(seen[far]) == pytest.approx(np.exp(-3) * (1 - np.exp(-3)), abs=1e-4)
        assert float(behind) == pytest.approx(np.exp(-6), abs=1e-6)


def test_what_stands_behind_the_camera_is_not_seen():
    seen, behind = visibilities(jnp.array([-1.0, 2.0]), jnp.array([0.1, 0.1]), jnp.array([3.0, 1.0]))
    assert float(seen[0]) == pytest.approx(0.0, abs=1e-9)
    assert float(seen[1]) == pytest.approx(1 - np.exp(-1), abs=1e-5)
    assert float(behind) == pytest.approx(np.exp(-1), abs=1e-6)


def test_a_ray_beside_a_gaussian_meets_less_of_it():
    centres, ways = jnp.array([[0.05, 0.0, 2.0], [0.0, 0.0, 2.0]]), jnp.array([0.0, 0.0, 1.0])
    along, depths = on_rays(centres, jnp.array([0.05, 0.05]), jnp.array([3.0, 3.0]), ways[None])
    np.testing.assert_allclose(along, [2.0, 2.0])
    np.testing.assert_allclose(depths, [3.0 * np.exp(-0.5), 3.0], rtol=1e-12)


def test_gradients_are_those_of_differences():
    """Of a weighted sum of visibilities, in places, widths and depths of the Gaussians, by central differences."""
    rng = np.random.default_rng(0)
    centres = jnp.asarray(np.array([0.0, 0.0, 3.0]) + rng.normal(0, 0.05, (5, 3)))
    sigmas, weights, way = (
        jnp.asarray(rng.uniform(0.03, 0.06, 5)),
        jnp.asarray(rng.uniform(0, 1, 6)),
        jnp.array([0.0, 0.0, 1.0]),
    )

    def cost(centres, sigmas, depth):
        seen, behind = visibilities(*_ray(centres, sigmas, depth))
        return jnp.sum(weights[:5] * seen) + weights[5] * behind

    def _ray(centres, sigmas, depth):
        along, depths = on_rays(centres, sigmas, depth, way[None])
        return along, sigmas, depths

    at = (centres, sigmas, jnp.full(5, 3.0))
    slopes, one = jax.grad(cost, (0, 1, 2))(*at), jax.jit(cost)
    for index, slope in enumerate(slopes):
        for place in np.ndindex(slope.shape):
            step = 1e-6
            ends = [one(*at[:index], at[index].at[place].add(sign * step), *at[index + 1 :]) for sign in (1, -1)]
            assert float(slope[place]) == pytest.approx(float(ends[0] - ends[1]) / (2 * step), abs=1e-6)
