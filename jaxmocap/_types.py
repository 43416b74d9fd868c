"""Shape words, scalar kinds and the field helper shared by every module.

Glossary of axis names in annotations: `frame camera height width face vertex bone dof particle joint`.
"""

from collections.abc import Callable
from typing import Any, Literal

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

Scalar = Float[Array, ""]
Knob = Float[Array, ""] | float
"""A hyper-parameter: any number when it is given, an array from then on (see `knob`)."""


def knob(default: float) -> Any:
    """Declare a field of an `eqx.Module` for a number that one may sweep: `weight: Float[Array, ""] = knob(0.1)`.

    It is an array leaf of single precision, so that changing it, or `vmap`-ing over it, never recompiles. Counts that
    fix a shape are static fields instead, `eqx.field(static=True)`.
    """
    as_array: Callable[[Any], Array] = lambda value: jnp.asarray(value, dtype=jnp.float32)  # noqa: E731
    return eqx.field(converter=as_array, default=default)


Say = Callable[[str], None]
"""Takes sentences on what was chosen or found."""

Report = Callable[[str, int, int], None]
"""Takes progress: the stage, how many of its steps are done, and how many there are."""

Quality = Literal["draft", "normal", "paper"]
