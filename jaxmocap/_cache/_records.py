"""Nested records as named arrays and one JSON text, without pickle: what checkpoints and cached stages are made of.

Numbers, texts, arrays, lists, tuples, deques, dictionaries and the package's own dataclasses and named tuples come back
exactly as they were. Reading builds nothing but these, so a file from a stranger cannot run code.
"""

import dataclasses
import hashlib
import importlib
import io
import json
import os
import zipfile
from collections import deque
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jaxmocap._files import write_bytes

_PACKAGE = __name__.split(".")[0]
_TREE = "__tree__"
_DAMAGE = (
    zipfile.BadZipFile,
    ValueError,
    KeyError,
    TypeError,
    AttributeError,
    IndexError,
    ImportError,
    EOFError,
    NotImplementedError,
    RecursionError,
)


class UnreadableRecord(Exception):
    """A file that does not hold records of this version."""


@dataclasses.dataclass(frozen=True)
class Stand:
    """Values of one type that are not stored but found again: `note` says by which plain value, `find` finds it."""

    type: type
    note: Callable[[Any], Any]
    find: Callable[[Any], Any]


def write_records(
    path: str | os.PathLike[str], value: Any, known: Mapping[str, Any] | None = None, stands: tuple[Stand, ...] = ()
) -> None:
    """Write `value` to `path` atomically.

    An object of `known` is stored as its name. Raises `TypeError` for a value of another kind.
    """
    encode = _Encoder(_by_identity(known), stands)
    tree, buffer = encode(value), io.BytesIO()
    named = {str(number): array for number, array in enumerate(encode.arrays)}
    np.savez(buffer, **{_TREE: np.asarray(json.dumps(tree)), **named})  # pyright: ignore[reportArgumentType]
    write_bytes(path, buffer.getvalue())


def read_records(
    path: str | os.PathLike[str], known: Mapping[str, Any] | None = None, stands: tuple[Stand, ...] = ()
) -> Any:
    """Read what `write_records` wrote; `known` and `stands` are those of the writing.

    Raises `UnreadableRecord` for a file that is damaged or of another version, `OSError` for one that cannot be opened.
    """
    try:
        with np.load(Path(path), allow_pickle=False) as stored:
            return _decoded(json.loads(str(stored[_TREE])), stored, known or {}, stands)
    except _DAMAGE as error:
        raise UnreadableRecord(f"{path}: {error}") from error


def digest(value: Any, foreign: bool = True) -> str:
    """Hash all that `write_records` would store: equal for equal content, whatever file it came from.

    Takes records of other packages too, and functions by their names, unless `foreign` is off: then they raise
    `TypeError`.
    """
    encode = _Encoder({}, foreign=foreign)
    found = hashlib.blake2b(json.dumps(encode(value)).encode(), digest_size=16)
    for array in encode.arrays:
        found.update(f"{array.dtype.str}{array.shape}".encode())
        found.update(np.ascontiguousarray(array).tobytes())
    return found.hexdigest()


def different(before: Mapping[str, Any], now: Mapping[str, Any]) -> str:
    """Name what in `now` has another value in `before`, as words in a sentence; empty when nothing has."""
    return " and ".join(name for name in now if before.get(name) != now[name])


def _by_identity(known: Mapping[str, Any] | None) -> dict[int, str]:
    return {id(item): name for name, item in (known or {}).items()}


@dataclasses.dataclass
class _Encoder:
    """Turns values into JSON, and collects the arrays. `foreign` takes records of other packages, and functions by
    name, which cannot be read again."""

    known: Mapping[int, str]
    stands: tuple[Stand, ...] = ()
    foreign: bool = False
    arrays: list[np.ndarray] = dataclasses.field(default_factory=list)

    def __call__(self, value: Any) -> Any:
        if id(value) in self.known:
            return {"known": self.known[id(value)]}
        for number, stand in enumerate(self.stands):
            if isinstance(value, stand.type):
                return {"stand": number, "note": self(stand.note(value))}
        if isinstance(value, np.generic):
            return {"scalar": self._stored(np.asarray(value))}
        if value is None or isinstance(value, bool | int | float | str):
            return value
        if isinstance(value, jax.Array):
            return {"device": self._stored(np.asarray(value))}
        if isinstance(value, np.ndarray):
            return {"array": self._stored(value)}
        if isinstance(value, deque):
            return {"deque": [self(item) for item in value], "length": value.maxlen}
        if type(value) in (list, tuple):
            return {type(value).__name__: [self(item) for item in value]}
        if type(value) is dict:
            return {"dict": [[self(key), self(item)] for key, item in value.items()]}
        return self._record(value)

    def _record(self, value: Any) -> Any:
        ours = type(value).__module__.split(".")[0] == _PACKAGE
        if ours or self.foreign:
            names = _fields(type(value))
            if names is not None:
                return {"record": _name(type(value)), "fields": {name: self(getattr(value, name)) for name in names}}
            if self.foreign and callable(value):
                return {"function": _name(value if hasattr(value, "__qualname__") else type(value))}
        raise TypeError(f"a value of type {type(value).__name__} cannot be stored")

    def _stored(self, array: np.ndarray) -> int:
        if array.dtype.hasobject:
            raise TypeError("an array of Python objects cannot be stored")
        self.arrays.append(array)
        return len(self.arrays) - 1


def _decoded(tree: Any, stored: Mapping[str, np.ndarray], known: Mapping[str, Any], stands: tuple[Stand, ...]) -> Any:
    def inner(item: Any) -> Any:
        return _decoded(item, stored, known, stands)

    if not isinstance(tree, dict):
        return tree
    kind = next(iter(tree))
    content = tree[kind]
    match kind:
        case "known":
            return known[content]
        case "stand":
            return stands[content].find(inner(tree["note"]))
        case "array":
            return stored[str(content)]
        case "device":
            return jax.device_put(stored[str(content)])  # jnp.asarray compiles a program for every shape
        case "scalar":
            return stored[str(content)][()]
        case "list":
            return [inner(item) for item in content]
        case "tuple":
            return tuple(inner(item) for item in content)
        case "deque":
            return deque((inner(item) for item in content), maxlen=tree["length"])
        case "dict":
            return {inner(key): inner(item) for key, item in content}
        case "record":
            return _built(content, {name: inner(item) for name, item in tree["fields"].items()})
    raise ValueError(f"it holds a {kind}")


def _name(what: Any) -> str:
    return f"{what.__module__}:{what.__qualname__}"


def _fields(cls: type) -> list[str] | None:
    """Names of the fields of a dataclass or a named tuple, None for any other type."""
    if dataclasses.is_dataclass(cls):
        return [field.name for field in dataclasses.fields(cls)]
    return list(getattr(cls, "_fields", ())) or None if issubclass(cls, tuple) else None


def _built(name: str, values: dict[str, Any]) -> Any:
    """Build a record of the package from its fields, as they were, without a constructor that may change them."""
    module, _, qualified = name.partition(":")
    if module.split(".")[0] != _PACKAGE or "." in qualified:
        raise ValueError(f"{name} is no record of {_PACKAGE}")
    cls = getattr(importlib.import_module(module), qualified)
    names = _fields(cls) if isinstance(cls, type) else None
    if names is None or set(names) != set(values):
        raise ValueError(f"{name} is no record with these fields")
    if issubclass(cls, tuple):
        return cls(**values)  # pyright: ignore[reportCallIssue]
    record = object.__new__(cls)
    for field, item in values.items():
        object.__setattr__(record, field, item)
    return record
