"""Programs as they are after tracing and lowering, kept from run to run: a warm start reads them instead of running
thousands of lines of Python again to the same end."""

import contextlib
import functools
import json
import os
import sys
import threading
import weakref
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any, ClassVar, ParamSpec, TypeVar, cast

import equinox as eqx
import jax.core
import numpy as np

from jaxmocap._files import keep_newest, write_json
from jaxmocap._runtime import quick_loops

from ._exported import (
    UNKEEPABLE,
    UNREADABLE,
    Program,
    code_hash,
    configuration,
    loaded,
    lowered,
    program_key,
    read_program,
    shape_of,
)
from ._records import digest, write_records

FOLDER = "JAXMOCAP_PROGRAMS"
"""The environment variable that names the folder; empty or absent: nothing is kept."""

LARGEST = 1 << 29
"""Bytes that exported programs may take; those that have not been used for longest go first."""

MOST_MAPS = 30_000
"""Memory maps of the process above which compiled programs are dropped."""

AHEAD = 24
"""As many programs are loaded ahead: about those that are used until the first frame is tracked."""

_PACKAGE = __name__.split(".")[0]
_P = ParamSpec("_P")
_T = TypeVar("_T")
_ahead: dict[Path, Future[Program]] = {}
_used: dict[str, None] = {}


def cached_jit(
    function: Callable[_P, _T], options: Callable[[], dict[str, Any]] = dict, on_cpu: bool = False
) -> Callable[_P, _T]:
    """Wrap a pure function of this package in `eqx.filter_jit`; its lowered programs are kept on disk (CPU only).

    It takes positional arguments. A program is taken from disk where the package's source, the versions of what traces
    it, JAX's configuration, the devices, every static value and the shape and type of every array are the same. Where
    an argument holds a value that cannot be compared with one of another run (a function, a record of somebody else),
    where the function is itself being traced, or where anything is wrong with the folder, the function is traced as
    ever. An exported program is what tracing gives, so the bits are the same. `options` gives XLA's options for a CPU.
    With `on_cpu` it runs there also where JAX has an accelerator.
    """
    return cast(Any, functools.wraps(function)(_CachedJit(function, options, on_cpu)))


def optimised_jit(function: Callable[_P, _T]) -> Callable[_P, _T]:
    """Wrap what runs for seconds in every frame in `cached_jit`, compiled for speed where that takes XLA longer."""
    return cached_jit(function, quick_loops)


def small_jit(function: Callable[_P, _T]) -> Callable[_P, _T]:
    """Wrap what takes thousands of small steps one after the other in `cached_jit`; it always runs on the CPU.

    An accelerator takes longer to begin such a step than a CPU to do it.
    """
    return cached_jit(function, on_cpu=True)


@contextlib.contextmanager
def programs_recorded(inputs: Mapping[str, Any]) -> Iterator[None]:
    """Note which programs the block uses first, for `preload_programs` of the next run with the same `inputs`."""
    _used.clear()
    try:
        yield
    finally:
        for loading in _ahead.values():
            loading.cancel()
        _ahead.clear()
    path = _note(inputs)
    if path is not None and _used:
        with contextlib.suppress(OSError):
            path.parent.mkdir(parents=True, exist_ok=True)
            write_json(path, list(_used)[:AHEAD])


def preload_programs(inputs: Mapping[str, Any]) -> None:
    """Load, in a thread beside whatever comes before them, the programs that the last run with these `inputs` used
    first. It is a hint: a program that the run does not ask for is never called."""
    path = _note(inputs)
    if path is None or jax.default_backend() != "cpu":
        return
    with contextlib.suppress(OSError, ValueError, TypeError):
        files = [path.parent / Path(name).name for name in json.loads(path.read_text())[:AHEAD]]
        worker = ThreadPoolExecutor(1, "programs")
        _ahead.update((file, worker.submit(read_program, file, True)) for file in files)
        worker.shutdown(wait=False)


def free_programs() -> None:
    """Drop the compiled programs of this package. Those of whoever uses it stay, and what was exported to disk too."""
    for program in list(_CachedJit.every):
        program.free()
    ours = f"{_PACKAGE}."
    for module in [module for name, module in sys.modules.items() if name.startswith(ours)]:
        for value in list(vars(module).values()):
            if isinstance(value, _CachedJit) or not str(getattr(value, "__module__", "")).startswith(ours):
                continue  # what a module has imported of others is theirs
            if hasattr(value, "clear_cache"):  # a function under jax.jit
                value.clear_cache()
            elif hasattr(value, "_cached"):  # a function under eqx.filter_jit, which wraps one under jax.jit
                value._cached.clear_cache()


def make_room() -> None:
    """Drop this package's compiled programs where memory maps fill half of what Linux allows a process: when it has no
    more, XLA ends it with a segmentation fault. Every capture of another size takes some thousands."""
    maps = Path("/proc/self/maps")
    if maps.is_file() and maps.read_bytes().count(b"\n") > MOST_MAPS:
        free_programs()


class _CachedJit:
    every: ClassVar["weakref.WeakSet[_CachedJit]"] = weakref.WeakSet()

    def __init__(self, function: Callable[..., Any], options: Callable[[], dict[str, Any]], on_cpu: bool):
        self.every.add(self)
        self.function = function
        self.options = options
        self.on_cpu = on_cpu
        self.programs: dict[Any, Program | None] = {}
        self.lock = threading.RLock()

    @functools.cached_property
    def traced(self) -> Callable[..., Any]:
        options = self.options() if jax.default_backend() == "cpu" else {}
        jit: Any = eqx.filter_jit
        return jit(self.function, compiler_options=options) if options else jit(self.function)

    def free(self) -> None:
        """Drop the compiled programs; the next call reads or traces them again."""
        for found in self.programs.values():
            if found is not None:
                found[0].clear_cache()
        self.programs.clear()
        if (traced := self.__dict__.pop("traced", None)) is not None:
            traced._cached.clear_cache()

    def __call__(self, *args: Any) -> Any:
        folder = os.environ.get(FOLDER, "")
        leaves, tree = jax.tree.flatten(args)
        arrays = [leaf for leaf in leaves if eqx.is_array(leaf)]
        inside = any(isinstance(one, jax.core.Tracer) for one in arrays)
        if self.on_cpu and jax.default_backend() != "cpu" and not inside:
            return self._from_accelerator(args)
        if not folder or jax.default_backend() != "cpu" or inside:
            return self.traced(*args)
        shapes = tuple(shape_of(leaf) if eqx.is_array(leaf) else (type(leaf), leaf) for leaf in leaves)
        known = (folder, tree, shapes, *(configuration().items()))
        with self.lock:  # what several threads ask for is traced once
            if known not in self.programs:
                self.programs[known] = self._program(Path(folder), tree, leaves, arrays)
            found = self.programs[known]
        if found is None:
            return self.traced(*args)
        program, answer = found
        values = jax.device_put([np.asarray(value) for value in program(*arrays)])  # as free to move as traced ones
        return jax.tree.unflatten(answer, values)

    def _from_accelerator(self, args: tuple[Any, ...]) -> Any:
        """Call it on the CPU, if JAX may use it; arguments and answer are on the accelerator."""
        try:
            cpu = jax.local_devices(backend="cpu")[0]
        except RuntimeError:
            return self.traced(*args)

        def moved(values: Any, device: Any) -> Any:
            arrays, others = eqx.partition(values, eqx.is_array)
            return eqx.combine(jax.device_put(jax.device_get(arrays), device), others)

        return moved(self.traced(*moved(args, cpu)), None)

    def _program(self, folder: Path, tree: Any, leaves: list[Any], arrays: list[Any]) -> Program | None:
        """From disk, or traced and put there; None where it cannot be kept."""
        options = self.options()
        try:
            key = program_key(self.function, options, tree, leaves)
        except TypeError:
            return None
        path = folder / f"{self.function.__name__.strip('_')}-{key}.npz"
        _used[path.name] = None
        with contextlib.suppress(*UNREADABLE):
            loading = _ahead.pop(path, None)
            found = read_program(path) if loading is None or loading.cancel() else loading.result()
            os.utime(path)
            return found
        try:
            stored = lowered(self.function, options, tree, leaves, arrays)
            program = loaded(stored)
        except UNKEEPABLE:
            return None
        with contextlib.suppress(OSError, TypeError):
            folder.mkdir(parents=True, exist_ok=True)
            write_records(path, stored)
            keep_newest(folder, LARGEST)
        return program


def _note(inputs: Mapping[str, Any]) -> Path | None:
    folder = os.environ.get(FOLDER, "")
    return Path(folder) / f"first-{digest(dict(inputs) | {'source': code_hash()})}.json" if folder else None
