"""One program as it is kept on disk: what it depends on, how it is lowered, and how it is loaded again."""

import hashlib
import platform
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.export
import numpy as np

from jaxmocap._runtime import versions

from ._records import UnreadableRecord, digest, read_records

_TRACED_BY = ("jax", "jaxlib", "equinox", "optimistix", "lineax", "jaxtyping", "numpy")
UNREADABLE = (OSError, ImportError, UnreadableRecord, KeyError, TypeError, ValueError, RuntimeError)
UNKEEPABLE = (ImportError, TypeError, ValueError, NotImplementedError, KeyError)
Program = tuple[Any, Any]
"""Of flat arrays to flat arrays, and the structure of the answer."""


@cache
def code_hash() -> str:
    """Hash the package's own source, so that nothing made by other code is taken for its own."""
    folder, found = Path(__file__).parents[1], hashlib.blake2b(digest_size=16)
    for path in sorted(folder.rglob("*.py")):
        found.update(str(path.relative_to(folder)).encode() + path.read_bytes())
    return found.hexdigest()


def machine() -> str:
    """Describe where programs run: kind and number of devices, and the processor; other ones round differently."""
    devices = jax.devices()
    return f"{len(devices)} x {devices[0].device_kind} on {platform.machine()} {platform.processor()}".strip()


def program_key(function: Callable[..., Any], options: dict[str, Any], tree: Any, leaves: list[Any]) -> str:
    """Hash all that a program depends on. Raises `TypeError` for values that have no name in another run."""
    described = [{"array": shape_of(leaf)} if eqx.is_array(leaf) else leaf for leaf in leaves]
    return digest(
        {
            "function": f"{function.__module__}:{function.__qualname__}",
            "arguments": jax.tree.unflatten(tree, described),
            "options": options,
            "source": code_hash(),
            "versions": versions(_TRACED_BY),
            "machine": machine(),
            "configuration": configuration(),
        },
        foreign=False,
    )


def lowered(
    function: Callable[..., Any], options: dict[str, Any], tree: Any, leaves: list[Any], arrays: list[Any]
) -> dict[str, Any]:
    """Trace a program and return what is stored of it."""
    fixed = [None if eqx.is_array(leaf) else leaf for leaf in leaves]
    places = [place for place, leaf in enumerate(leaves) if eqx.is_array(leaf)]
    answers: list[Any] = []

    def flat(*arrays: Any) -> list[Any]:
        filled = list(fixed)
        for place, array in zip(places, arrays, strict=True):
            filled[place] = array
        values, answer = jax.tree.flatten(function(*jax.tree.unflatten(tree, filled)))
        if any(not eqx.is_array(value) or shape_of(value)[-1] or _is_key(value) for value in values):
            raise TypeError("an answer that is no plain array would not come back as it was")
        answers.append(answer)
        return values

    flat.__name__ = function.__name__
    weak = [shape_of(array)[-1] for array in arrays]
    specs = [jax.ShapeDtypeStruct(a.shape, a.dtype, weak_type=w) for a, w in zip(arrays, weak, strict=True)]
    exported = jax.export.export(jax.jit(flat))(*specs)
    answer = jax.tree.unflatten(answers[-1], list(range(len(exported.out_avals))))
    program = np.frombuffer(exported.serialize(), np.uint8)
    about = {"name": function.__name__, "options": options, "weak": weak, "answer": answer}
    return about | {"program": program}


def read_program(path: Path, compile_it: bool = False) -> Program:
    """Load a program from its file."""
    return loaded(read_records(path), compile_it)


def loaded(stored: dict[str, Any], compile_it: bool = False) -> Program:
    """Load a stored program; with `compile_it` XLA has it ready before it is first called."""
    exported = jax.export.deserialize(bytearray(stored["program"].tobytes()))

    def program(*arrays: Any) -> Any:
        return exported.call(*arrays)

    program.__name__ = stored["name"]
    options = {"compiler_options": stored["options"]} if stored["options"] else {}
    if exported.nr_devices > 1:
        mesh = jax.sharding.Mesh(np.array(jax.local_devices()), ("every",))
        options["in_shardings"] = jax.sharding.NamedSharding(mesh, jax.sharding.PartitionSpec())
    jitted = jax.jit(program, **options)
    if compile_it:
        specs = zip(exported.in_avals, stored["weak"], strict=True)
        jitted.lower(*(jax.ShapeDtypeStruct(a.shape, a.dtype, weak_type=weak) for a, weak in specs)).compile()
    return jitted, jax.tree.structure(stored["answer"])


def _is_key(array: Any) -> bool:
    return jax.dtypes.issubdtype(array.dtype, jax.dtypes.prng_key)


def shape_of(array: Any) -> tuple[str, tuple[int, ...], bool]:
    """Describe an array by what a program is traced for: type, shape, and whether its type is weak."""
    return str(array.dtype), tuple(array.shape), bool(getattr(array, "weak_type", False))


def configuration() -> dict[str, str]:
    """List JAX's settings as they are now."""
    return {name: str(getattr(jax.config, name, value)) for name, value in jax.config.values.items()}
