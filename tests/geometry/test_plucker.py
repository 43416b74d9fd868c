import jax
import jax.numpy as jnp
import numpy as np

from jaxmocap.geometry import pluecker_line, point_line_residual


def test_residual_vanishes_on_the_line_and_has_the_length_of_the_distance():
    rng = np.random.default_rng(0)
    centre, direction, point = (jnp.asarray(rng.normal(size=(20, 3)), jnp.float32) for _ in range(3))
    n, m = pluecker_line(centre, direction)
    on_line = centre + 1.7 * direction
    np.testing.assert_allclose(point_line_residual(on_line, n, m), 0.0, atol=2e-6)
    unit = np.asarray(direction) / np.linalg.norm(direction, axis=1, keepdims=True)
    offset = np.asarray(point - centre)
    distance = np.linalg.norm(offset - (offset * unit).sum(1, keepdims=True) * unit, axis=1)
    np.testing.assert_allclose(jnp.linalg.norm(point_line_residual(point, n, m), axis=-1), distance, rtol=1e-5)


def test_the_line_does_not_depend_on_the_point_chosen_on_it_nor_on_the_length_of_the_direction():
    centre, direction = jnp.array([0.3, -1.0, 2.0]), jnp.array([1.0, 2.0, -0.5])
    one, other = pluecker_line(centre, direction), pluecker_line(centre - 3 * direction, 5 * direction)
    np.testing.assert_allclose(one[0], other[0], atol=1e-6)
    np.testing.assert_allclose(one[1], other[1], atol=1e-5)


def test_known_line():
    # the line through (0, 1, 0) along z; a point 2 to the side and 1 above it
    n, m = pluecker_line(jnp.array([0.0, 1, 0]), jnp.array([0.0, 0, 2]))
    np.testing.assert_allclose(n, [0, 0, 1])
    np.testing.assert_allclose(m, [1, 0, 0])
    np.testing.assert_allclose(point_line_residual(jnp.array([2.0, 2, 7]), n, m), [1, -2, 0])


def test_one_centre_broadcasts_over_rays_and_the_gradient_equals_finite_differences():
    directions = jnp.asarray(np.random.default_rng(1).normal(size=(4, 3)), jnp.float32)
    m = pluecker_line(jnp.ones(3), directions)[1]
    assert m.shape == (4, 3)
    with jax.enable_x64(True):
        centre, ray, point = np.array([0.1, 0.2, -3.0]), np.array([0.3, -0.1, 1.0]), np.array([0.5, 0.2, 1.0])

        def energy(direction):
            return jnp.sum(point_line_residual(jnp.asarray(point), *pluecker_line(jnp.asarray(centre), direction)) ** 2)

        gradient = jax.grad(energy)(jnp.asarray(ray))
        for axis in range(3):
            step = np.eye(3)[axis] * 1e-6
            numeric = (energy(jnp.asarray(ray + step)) - energy(jnp.asarray(ray - step))) / 2e-6
            np.testing.assert_allclose(gradient[axis], numeric, rtol=1e-6)
