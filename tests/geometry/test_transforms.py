"""SO(3) and SE(3) against SciPy's matrix exponential, at zero, at pi and in between, in values and gradients."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import expm

from jaxmocap.geometry import (
    hat,
    inverse,
    matmul,
    rigid,
    se3_exp,
    so3_exp,
    so3_left_jacobian,
    so3_log,
    transform,
)

ANGLES = [0.0, 1e-9, 1e-4, 0.03, 0.999, 1.001, 2.0, 3.0, np.pi - 1e-4, np.pi - 1e-8]


def twist_of(angle: float, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    axis = rng.normal(size=3)
    return np.concatenate([rng.normal(size=3), angle * axis / np.linalg.norm(axis)])


def matrix_of(twist: np.ndarray) -> np.ndarray:
    matrix = np.zeros((4, 4))
    matrix[:3, :3] = hat(jnp.asarray(twist[3:]))
    matrix[:3, 3] = twist[:3]
    return matrix


@pytest.fixture(autouse=True)
def double_precision():
    with jax.enable_x64():
        yield


def test_hat_is_the_cross_product():
    a, b = np.random.default_rng(0).normal(size=(2, 5, 3))
    np.testing.assert_allclose(np.einsum("nij,nj->ni", hat(jnp.asarray(a)), b), np.cross(a, b), atol=1e-15)


@pytest.mark.parametrize("angle", ANGLES)
def test_exponentials_equal_the_matrix_exponential(angle):
    twist = twist_of(angle)
    expected = expm(matrix_of(twist))
    np.testing.assert_allclose(se3_exp(jnp.asarray(twist)), expected, atol=1e-13)
    np.testing.assert_allclose(so3_exp(jnp.asarray(twist[3:])), expected[:3, :3], atol=1e-13)


@pytest.mark.parametrize("angle", ANGLES)
def test_logarithms_undo_exponentials(angle):
    vector = jnp.asarray(twist_of(angle)[3:])
    np.testing.assert_allclose(so3_log(so3_exp(vector)), vector, atol=1e-12)


@pytest.mark.parametrize("axis", np.eye(3).tolist() + [[0.6, -0.8, 0.0], [-0.48, 0.6, 0.64]])
def test_logarithm_of_a_half_turn_has_length_pi_along_the_axis(axis):
    vector = so3_log(2 * jnp.outer(jnp.array(axis), jnp.array(axis)) - jnp.eye(3))
    assert float(jnp.linalg.norm(vector)) == pytest.approx(np.pi, abs=1e-12)
    assert abs(float(np.dot(vector, axis))) == pytest.approx(np.pi, abs=1e-12)


def test_single_precision_round_trip_near_pi():
    with jax.enable_x64(False):
        vector = jnp.array([2.0, -1.5, 1.8], jnp.float32)
        vector = vector / jnp.linalg.norm(vector) * (jnp.pi - 1e-3)
        np.testing.assert_allclose(so3_log(so3_exp(vector)), vector, atol=2e-6)


@jax.jit
def derivatives_of_a_round_trip(vector):
    return [jacobian(lambda x: so3_log(so3_exp(x)))(vector) for jacobian in (jax.jacfwd, jax.jacrev)]


@pytest.mark.parametrize("angle", ANGLES[:-1])
def test_round_trip_has_the_identity_as_its_derivative(angle):
    for derivative in derivatives_of_a_round_trip(jnp.asarray(twist_of(angle)[3:])):
        np.testing.assert_allclose(derivative, np.eye(3), atol=1e-7)


@jax.jit
@jax.hessian
def curvature(twist):
    return jnp.sum(jnp.sin(se3_exp(twist)) + so3_left_jacobian(twist[3:])[0, 0])


@pytest.mark.parametrize("angle", [0.0, 1e-9, 0.5, 2.5])
def test_second_derivatives_are_finite(angle):
    assert np.all(np.isfinite(curvature(jnp.asarray(twist_of(angle)))))


@pytest.mark.parametrize("angle", [0.0, 0.3, 0.999, 1.001, 3.0, 5.0])
def test_left_jacobian_equals_its_series(angle):
    vector = jnp.asarray(twist_of(angle)[3:])
    matrix, power, total, factorial = np.asarray(hat(vector)), np.eye(3), np.zeros((3, 3)), 1.0
    for k in range(60):
        factorial *= k + 1
        total += power / factorial
        power = power @ matrix
    np.testing.assert_allclose(so3_left_jacobian(vector), total, atol=1e-12)


@pytest.mark.parametrize("angle", [0.0, 0.3, 2.0])
def test_left_jacobian_is_the_derivative_of_the_exponential(angle):
    vector = jnp.asarray(twist_of(angle)[3:])
    back = so3_exp(-vector)
    derivative = jax.jacfwd(lambda x: so3_log(matmul(so3_exp(x), back)))(vector)
    np.testing.assert_allclose(so3_left_jacobian(vector), derivative, atol=1e-10)


def test_batches_of_transforms_agree():
    twists = jnp.stack([jnp.asarray(twist_of(angle, n)) for n, angle in enumerate((0.1, 1.0, 2.0))])
    poses = se3_exp(twists)
    points = jnp.asarray(np.random.default_rng(0).normal(size=(3, 7, 3)))
    expected = np.einsum("bij,bnj->bni", poses[:, :3, :3], points) + poses[:, None, :3, 3]
    np.testing.assert_allclose(transform(poses, points), expected, atol=1e-14)
    np.testing.assert_allclose(rigid(poses[:, :3, :3], poses[:, :3, 3]), poses, atol=0)


def test_inverse_of_a_projection_is_exact_to_single_precision():
    rng = np.random.default_rng(3)
    intrinsics = np.array([[900.0, 0, 480], [0, 900, 270], [0, 0, 1]])
    turned = intrinsics @ np.asarray(so3_exp(jnp.asarray(rng.normal(size=(20, 3)), jnp.float32)), np.float64)
    found = np.asarray(inverse(jnp.asarray(turned, jnp.float32)))
    expected = np.linalg.inv(turned)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-5 * np.abs(expected).max())
