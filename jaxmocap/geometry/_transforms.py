"""SO(3) and SE(3): exponentials and the logarithm of a rotation, safe to differentiate everywhere.

Twists are `(v, w)`, linear part first (Murray, Li and Sastry 1994). Every function takes leading batch axes, and no
matrix product goes through a matrix unit, whose reduced precision (TF32) would cost millimetres.
"""

import math

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

_NUM_TERMS = 9  # at |w| = 1 the first dropped term is below 1e-17


def hat(vector: Float[Array, "*batch 3"]) -> Float[Array, "*batch 3 3"]:
    """Build the cross-product matrix: `hat(a) @ b = a x b`."""
    x, y, z = vector[..., 0], vector[..., 1], vector[..., 2]
    zero = jnp.zeros_like(x)
    entries = jnp.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1)
    return entries.reshape(*vector.shape[:-1], 3, 3)


def matmul(a: Float[Array, "*batch i j"], b: Float[Array, "*batch j k"]) -> Float[Array, "*batch i k"]:
    """Multiply small matrices by a sum of products, which XLA fuses and never rounds to TF32."""
    return jnp.sum(a[..., :, :, None] * b[..., None, :, :], axis=-2)


def inverse(matrix: Float[Array, "*batch 3 3"]) -> Float[Array, "*batch 3 3"]:
    """Invert small matrices by the cross products of their rows: a tenth of what a factorisation is to compile."""
    first, second, third = (matrix[..., row, :] for row in range(3))
    columns = jnp.stack([jnp.cross(second, third), jnp.cross(third, first), jnp.cross(first, second)], axis=-1)
    return columns / jnp.sum(first * columns[..., 0], axis=-1)[..., None, None]


def transform(matrix: Float[Array, "*batch 4 4"], points: Float[Array, "*batch point 3"]) -> Float[Array, "..."]:
    """Carry points (..., N, 3) by rigid transforms (..., 4, 4)."""
    rotated = jnp.sum(matrix[..., None, :3, :3] * points[..., None, :], axis=-1)
    return rotated + matrix[..., None, :3, 3]


def rigid(rotation: Float[Array, "*batch 3 3"], translation: Float[Array, "*batch 3"]) -> Float[Array, "*batch 4 4"]:
    """Build the 4x4 matrix of a rotation and a translation."""
    top = jnp.concatenate([rotation, translation[..., None]], axis=-1)
    bottom = jnp.broadcast_to(jnp.array([0.0, 0.0, 0.0, 1.0], top.dtype), (*top.shape[:-2], 1, 4))
    return jnp.concatenate([top, bottom], axis=-2)


def so3_exp(vector: Float[Array, "*batch 3"]) -> Float[Array, "*batch 3 3"]:
    """Compute the rotation matrix of a rotation vector (radians), Rodrigues: `R = I + A w^ + B w^^2`."""
    w = hat(vector)
    a, b = (s[..., None, None] for s in _coefficients(_square(vector), 1, 2))
    return jnp.eye(3, dtype=vector.dtype) + a * w + b * matmul(w, w)


def so3_log(rotation: Float[Array, "*batch 3 3"]) -> Float[Array, "*batch 3"]:
    """Compute the rotation vector, |w| <= pi, of a rotation matrix; through the quaternion, so exact near pi too.

    At exactly pi both signs are right and one is returned.
    """
    m = rotation
    diagonal = [m[..., 0, 0], m[..., 1, 1], m[..., 2, 2]]
    trace = diagonal[0] + diagonal[1] + diagonal[2]
    skew = [m[..., 2, 1] - m[..., 1, 2], m[..., 0, 2] - m[..., 2, 0], m[..., 1, 0] - m[..., 0, 1]]
    xy, xz, yz = m[..., 0, 1] + m[..., 1, 0], m[..., 0, 2] + m[..., 2, 0], m[..., 1, 2] + m[..., 2, 1]
    squares = [1 + trace] + [1 + 2 * d - trace for d in diagonal]
    rows = jnp.stack(  # 4 q q^T for the quaternion q = (w, x, y, z): every row is a multiple of q
        [
            jnp.stack([squares[0], *skew], -1),
            jnp.stack([skew[0], squares[1], xy, xz], -1),
            jnp.stack([skew[1], xy, squares[2], yz], -1),
            jnp.stack([skew[2], xz, yz, squares[3]], -1),
        ],
        axis=-2,
    )
    best = jnp.argmax(jnp.stack(squares, -1), axis=-1)
    row = jnp.take_along_axis(rows, best[..., None, None], axis=-2)[..., 0, :]
    quaternion = row / jnp.sqrt(_square(row))[..., None]
    quaternion = quaternion * jnp.where(quaternion[..., :1] < 0, -1.0, 1.0)
    real, imaginary = quaternion[..., 0], quaternion[..., 1:]
    square = _square(imaginary)
    small = square < 1e-6
    length = jnp.sqrt(jnp.where(small, 1.0, square))
    large_ratio = 2 * jnp.arctan2(length, real) / length
    safe_real = jnp.where(small, real, 1.0)
    ratio = square / safe_real**2
    small_ratio = 2 / safe_real * (1 - ratio / 3 + ratio**2 / 5)
    return jnp.where(small, small_ratio, large_ratio)[..., None] * imaginary


def so3_left_jacobian(vector: Float[Array, "*batch 3"]) -> Float[Array, "*batch 3 3"]:
    """Compute `V = I + B w^ + C w^^2`: `exp((w + dw)^) = exp((V dw)^) exp(w^)` to first order.

    SE(3)'s translation has the same V.
    """
    w = hat(vector)
    b, c = (s[..., None, None] for s in _coefficients(_square(vector), 2, 3))
    return jnp.eye(3, dtype=vector.dtype) + b * w + c * matmul(w, w)


def se3_exp(twist: Float[Array, "*batch 6"]) -> Float[Array, "*batch 4 4"]:
    """Compute the rigid transform of a twist `(v, w)`: rotation `exp(w^)`, translation `V v`."""
    linear, angular = twist[..., :3], twist[..., 3:]
    translation = jnp.sum(so3_left_jacobian(angular) * linear[..., None, :], axis=-1)
    return rigid(so3_exp(angular), translation)


def _square(vector: Array) -> Array:
    return jnp.sum(vector * vector, axis=-1)


def _horner(coefficients: list[float], x: Array) -> Array:
    total = jnp.full_like(x, coefficients[-1])
    for coefficient in reversed(coefficients[:-1]):
        total = total * x + coefficient
    return total


def _coefficients(square: Array, *orders: int) -> tuple[Array, ...]:
    """`S_n = sum_k (-t^2)^k / (2k + n)!` for n in 1..3: sin t / t, (1 - cos t) / t^2, (t - sin t) / t^3.

    A series for t < 1, the closed form beyond: each branch is fed a value it can differentiate.
    """
    small = square < 1.0
    inside, outside = jnp.where(small, square, 0.0), jnp.where(small, 1.0, square)
    length = jnp.sqrt(outside)
    closed = {1: jnp.sin(length) / length, 2: 0.5 * (jnp.sin(0.5 * length) / (0.5 * length)) ** 2}
    closed[3] = (1.0 - closed[1]) / outside
    series = {n: _horner([(-1.0) ** k / math.factorial(2 * k + n) for k in range(_NUM_TERMS)], inside) for n in orders}
    return tuple(jax.lax.select(small, series[n], closed[n]) for n in orders)
