"""A pickle of arrays in a dictionary, read without running what it names: other data sets give such files.

`find_class` is where a pickle gets at code. Here it knows five names of NumPy's and one of Python's, and gives for
each a stand-in of ours, which only takes numbers out of bytes; every other name is refused.
"""

import io
import math
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from jaxmocap._results import InputError

_LARGEST = 2**20  # bytes of a file, and numbers in it
_TYPES = {"f4", "f8", "i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8"}


class _Type:
    """What stands for a dtype."""

    def __init__(self, code: str, *_: Any) -> None:
        if code not in _TYPES:
            raise ValueError(f"it has elements of the type {code!r}")
        self.code = "<" + code

    def __setstate__(self, state: tuple) -> None:
        order = state[1]
        if order not in ("<", ">", "|", "="):
            raise ValueError(f"it has the byte order {order!r}")
        self.code = (">" if order == ">" else "<") + self.code[1:]


class _Array:
    """What stands for an array until its state is known."""

    values: np.ndarray

    def __setstate__(self, state: tuple) -> None:
        _, shape, kind, by_columns, data = state
        self.values = _numbers(data, kind, shape, "F" if by_columns else "C")


def _numbers(data: bytes | bytearray, kind: _Type, shape: tuple[int, ...], order: Any = "C") -> np.ndarray:
    if not isinstance(data, bytes | bytearray):  # of a number Python makes so many bytes
        raise ValueError(f"it has an array of the data {data!r:.40}")
    if not isinstance(kind, _Type) or math.prod(shape) > _LARGEST or order not in ("C", "F"):
        raise ValueError(f"it has an array of shape {shape}")
    return np.frombuffer(bytes(data), kind.code).reshape(shape, order=order)


def _from_buffer(data: bytes, kind: _Type, shape: tuple[int, ...], order: str) -> _Array:
    found = _Array()
    found.values = _numbers(data, kind, shape, order)
    return found


_STAND_INS: dict[tuple[str, str], Callable] = {
    ("multiarray", "_reconstruct"): lambda *_: _Array(),
    ("numeric", "_frombuffer"): _from_buffer,
    ("multiarray", "scalar"): lambda kind, data: _from_buffer(data, kind, (), "C"),
    ("numpy", "dtype"): _Type,
    ("numpy", "ndarray"): lambda *_: _Array(),
    ("_codecs", "encode"): lambda text, _: text.encode("latin1"),
}


class _StandIn:
    """Something to be called, whose attributes a pickle cannot set."""

    __slots__ = ("_call",)

    def __init__(self, call: Callable) -> None:
        self._call = call

    def __call__(self, *arguments: Any) -> Any:
        return self._call(*arguments)


class _Unpickler(pickle._Unpickler):
    """The unpickler that is written in Python: no number in a file makes it ask for much memory."""

    dispatch: ClassVar = dict(pickle._Unpickler.dispatch)
    dispatch[pickle.BYTEARRAY8[0]] = dispatch[pickle.BINBYTES8[0]]

    def find_class(self, module_name: str, global_name: str) -> Any:
        """Return the stand-in of a name. Raises `UnpicklingError` for any that is not known."""
        module = module_name.removeprefix("numpy.core.").removeprefix("numpy._core.")
        known = _STAND_INS.get((module, global_name))
        if known is None:
            raise pickle.UnpicklingError(f"it asks for {module_name}.{global_name}, which is no array")
        return _StandIn(known)


def read_array_pickle(path: Path) -> dict[str, np.ndarray]:
    """Read the numeric arrays of a pickled dictionary by their names; what else is in it is passed over.

    Raises `InputError` for a file that is missing, larger than a megabyte, no such dictionary, or asks for anything but
    arrays of numbers.
    """
    try:
        data = path.read_bytes() if path.stat().st_size <= _LARGEST else None
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror or error}).") from None
    if data is None:
        raise InputError(f"{path} is larger than a megabyte; a pickle of a camera was expected.")
    try:
        found = _Unpickler(io.BytesIO(data)).load()
    except Exception as error:  # a damaged pickle may fail in any way
        raise InputError(
            f"{path} is no pickle of arrays that is read here ({str(error) or type(error).__name__}); only numbers in "
            "arrays in a dictionary are taken, and nothing in it was run: get the file again from where the data set "
            "is published."
        ) from None
    if not isinstance(found, dict):
        raise InputError(f"{path} holds something else than a dictionary of arrays, which was expected.")
    arrays = {name: value for name, value in found.items() if isinstance(name, str) and isinstance(value, _Array)}
    return {name: array.values for name, array in arrays.items() if hasattr(array, "values")}
