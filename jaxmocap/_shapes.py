"""Shapes of arrays and keys that users pass, checked where they come in: a sentence, not an error from inside JAX."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ._results import InputError


def check_shape(what: str, values: Any, expected: tuple[int | str, ...], hint: str = "") -> None:
    """Raise `InputError` unless an array has this shape.

    In `expected` a number is that length, a word names an axis of any length, and a first `...` stands for any leading
    axes. Shapes are known while JAX traces, so that a compiled program checks nothing.
    """
    shape, wanted = np.shape(values), tuple(axis for axis in expected if axis != "...")
    led = len(wanted) < len(expected)
    own = shape[len(shape) - len(wanted) :] if led else shape
    fits = len(own) == len(wanted) and all(
        length == axis or not isinstance(axis, int) for length, axis in zip(own, wanted, strict=True)
    )
    if not fits:
        words = ", ".join(map(str, expected)) + "," * (len(expected) == 1)
        raise InputError(f"{what} has the shape {shape}; ({words}) was expected{': ' if hint else ''}{hint}.")


def check_key(key: Any) -> None:
    """Raise `InputError` unless this is one key of JAX's random numbers, of the new style or the old."""
    new = isinstance(key, jax.Array) and jnp.issubdtype(key.dtype, jax.dtypes.prng_key) and key.ndim == 0
    old = isinstance(key, jax.Array | np.ndarray) and key.dtype == np.uint32 and key.ndim == 1
    if not (new or old):
        found = repr(key) if isinstance(key, int | float | str) else f"{type(key).__name__} of shape {np.shape(key)}"
        raise InputError(f"key is {found}; give one key of JAX's, such as jax.random.key(0).")
