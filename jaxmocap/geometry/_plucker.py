"""Lines in Pluecker coordinates."""

import jax.numpy as jnp
from jaxtyping import Array, Float


def pluecker_line(
    centre: Float[Array, "*batch 3"], direction: Float[Array, "*batch 3"]
) -> tuple[Float[Array, "*batch 3"], Float[Array, "*batch 3"]]:
    """The line through `centre` along `direction`: unit direction n and moment m = centre x n (metres).

    Leading axes broadcast: one camera centre with many viewing rays gives one line per ray.
    """
    normal = direction / jnp.linalg.norm(direction, axis=-1, keepdims=True)
    return normal, jnp.cross(jnp.broadcast_to(centre, normal.shape), normal)


def point_line_residual(
    point: Float[Array, "*batch 3"], n: Float[Array, "*batch 3"], m: Float[Array, "*batch 3"]
) -> Float[Array, "*batch 3"]:
    """Eq. 9's residual e = v x n - m: zero on the line, and |e| is the distance of the point from it in metres."""
    return jnp.cross(point, n) - m
