"""Running a network of TensorFlow Lite."""

import importlib.util
from collections.abc import Sequence

import numpy as np

from jaxmocap._results import InputError
from jaxmocap._runtime import cores

from ._person_model import Network


def require_runner() -> None:
    """Raise the `InputError` of a runner that is not installed."""
    if importlib.util.find_spec("ai_edge_litert") is None:
        raise InputError(
            "detect needs the package ai-edge-litert, which is not installed here; run: pip install 'jaxmocap[detect]'"
        )


def open_network(content: bytes, name: str, shapes: Sequence[tuple[int, ...]]) -> Network:
    """Open the content of a TensorFlow Lite file, to be run on all cores. `shapes` are those expected of its input and
    of its outputs in order. Raises `InputError`, which calls it `name`, where the runner is not installed or it is not
    such a network."""
    require_runner()
    from ai_edge_litert.interpreter import Interpreter  # pyright: ignore[reportMissingImports]

    try:
        interpreter = Interpreter(model_content=content, num_threads=cores())
        interpreter.allocate_tensors()
    except (ValueError, RuntimeError) as error:
        raise InputError(f"{name} is no network of TensorFlow Lite: {error}") from None
    entry, *outputs = (*interpreter.get_input_details(), *interpreter.get_output_details())
    found = [tuple(map(int, one["shape"])) for one in (entry, *outputs)]
    if found != list(shapes):
        raise InputError(f"{name} is another network: its input and outputs are {found}, {list(shapes)} was expected")

    def run(picture: np.ndarray) -> list[np.ndarray]:
        interpreter.set_tensor(entry["index"], picture)
        interpreter.invoke()
        return [interpreter.get_tensor(one["index"]) for one in outputs]

    return run
