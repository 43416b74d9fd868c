"""Running a network of TensorFlow Lite."""

import contextlib
import importlib.util
import os
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

from jaxmocap._results import InputError
from jaxmocap._runtime import cores

from ._person_model import Network

_AT_ONCE = 2
"""Pictures that are looked at side by side: two networks on half of the cores each are faster than one on all."""


def require_runner() -> None:
    """Raise the `InputError` of a runner that is not installed."""
    if importlib.util.find_spec("ai_edge_litert") is None:
        raise InputError(
            "detect needs the package ai-edge-litert, which is not installed here; run: pip install 'jaxmocap[detect]'"
        )


def open_network(content: bytes, name: str, shapes: Sequence[tuple[int, ...]]) -> Network:
    """Open the content of a TensorFlow Lite file, to be run on all cores.

    `shapes` are those expected of its input and of its outputs in order. Raises `InputError`, which calls it `name`,
    where the runner is not installed or it is not such a network.
    """
    require_runner()
    from ai_edge_litert.interpreter import Interpreter  # pyright: ignore[reportMissingImports]

    try:
        with _silent():
            workers = [_Worker(Interpreter(model_content=content, num_threads=max(cores() // _AT_ONCE, 1)))]
    except (ValueError, RuntimeError) as error:
        raise InputError(f"{name} is no network of TensorFlow Lite: {error}") from None
    if workers[0].shapes != list(shapes):
        raise InputError(
            f"{name} is another network: its input and outputs are {workers[0].shapes}, {list(shapes)} was expected"
        )
    for _ in range(1, min(_AT_ONCE, cores())):
        workers.append(_Worker(Interpreter(model_content=content, num_threads=max(cores() // _AT_ONCE, 1))))
    pool = ThreadPoolExecutor(len(workers), thread_name_prefix="network")

    def run(pictures: np.ndarray) -> list[np.ndarray]:
        if len(pictures) == 1:
            return workers[0].run(pictures)
        shares = [range(first, len(pictures), len(workers)) for first in range(len(workers))]
        done = list(
            pool.map(lambda worker, share: {n: worker.run(pictures[n : n + 1]) for n in share}, workers, shares)
        )
        found = {number: outputs for one in done for number, outputs in one.items()}
        ordered = [found[number] for number in range(len(pictures))]
        return [np.concatenate(outputs) for outputs in zip(*ordered, strict=True)]

    return run


@contextlib.contextmanager
def _silent() -> Iterator[None]:
    """Keep from standard error what the library itself writes there, whatever happens: that it is at work."""
    sys.stderr.flush()
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)


class _Worker:
    """One copy of a network, which one thread uses at a time."""

    def __init__(self, interpreter: Any):
        interpreter.allocate_tensors()
        self._interpreter = interpreter
        self._entry, *self._outputs = (*interpreter.get_input_details(), *interpreter.get_output_details())
        self.shapes = [tuple(map(int, one["shape"])) for one in (self._entry, *self._outputs)]

    def run(self, picture: np.ndarray) -> list[np.ndarray]:
        self._interpreter.set_tensor(self._entry["index"], picture)
        self._interpreter.invoke()
        return [self._interpreter.get_tensor(one["index"]) for one in self._outputs]
