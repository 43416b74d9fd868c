"""Calls shared among processes through Dask, of this machine or of a cluster; without it, one after the other."""

import os
import traceback
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple, TypeVar

from jaxmocap._results import InputError
from jaxmocap._runtime import configure

Item = TypeVar("Item")
Result = TypeVar("Result")


class Failure(NamedTuple):
    """What is recorded of a call that failed.

    Attributes:
        error: one sentence for a user's mistake, else the kind of the exception and what it says.
        traceback: of an error of ours; None for a user's mistake.
    """

    error: str
    traceback: str | None

    @classmethod
    def of(cls, error: BaseException) -> "Failure":
        """Describe an exception."""
        if isinstance(error, InputError):
            return cls(str(error), None)
        return cls("".join(traceback.format_exception_only(error)).strip(), "".join(traceback.format_exception(error)))


def on_workers(
    call: Callable[[Item], Result],
    items: Sequence[Item],
    died: Callable[[Item, BaseException], Result],
    workers: int | None = None,
    scheduler: str | None = None,
) -> Iterator[Result]:
    """Call `call` with every item; iterate over what it returns, in the order in which calls are done.

    `workers` processes share the items through Dask where the extra `cluster` is installed: by default one for every
    four cores, and 0 or 1 stay in this process. They keep compiled programs in the same caches (`configure`).
    `scheduler` is the address or scheduler file of a Dask cluster that is running, on several machines say. `died`
    stands in for `call` where processes were killed over an item, or where a call raises there.

    Raises `InputError` for a number of workers below 0, where Dask is needed and not installed and, with the first
    result, where no scheduler answers.
    """
    check_workers(workers, scheduler)
    distributed = _dask()
    workers = (os.cpu_count() or 1) // 4 if workers is None else workers
    if distributed is None or (scheduler is None and (workers < 2 or len(items) < 2)):
        return map(call, items)
    return _shared(distributed, call, items, died, workers, scheduler)


def _shared(
    distributed: ModuleType,
    call: Callable[[Item], Result],
    items: Sequence[Item],
    died: Callable[[Item, BaseException], Result],
    workers: int,
    scheduler: str | None,
) -> Iterator[Result]:
    with _client(distributed, min(workers, len(items)), scheduler) as client:
        client.register_worker_callbacks(configure)
        sent = {client.submit(call, item, pure=False): item for item in items}
        for future in distributed.as_completed(sent):
            error = future.exception()
            yield future.result() if error is None else died(sent[future], error)


def check_workers(workers: int | None, scheduler: str | None) -> None:
    """Raise `InputError` for a number of workers below 0, and where Dask is needed and not installed."""
    if workers is not None and workers < 0:
        raise InputError(f"the number of workers is {workers}; give 0 or more.")
    if ((workers or 0) > 1 or scheduler is not None) and _dask() is None:
        raise InputError(
            "several workers need Dask, which is not installed; run pip install 'jaxmocap[cluster]', or leave "
            "--workers and --scheduler out."
        )


def _dask() -> ModuleType | None:
    try:
        import distributed  # pyright: ignore[reportMissingImports]
    except ImportError:
        return None
    return distributed


def _client(distributed: ModuleType, workers: int, scheduler: str | None) -> Any:
    if scheduler is None:
        return distributed.Client(n_workers=workers, threads_per_worker=1, dashboard_address=None)
    try:
        if Path(scheduler).is_file():
            return distributed.Client(scheduler_file=scheduler)
        return distributed.Client(scheduler)
    except (OSError, ValueError) as error:
        raise InputError(
            f"no Dask scheduler answers at {scheduler} ({error}); give the address that it prints, such as "
            "tcp://10.0.0.5:8786, or its scheduler file."
        ) from error
