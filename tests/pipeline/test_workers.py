"""Calls shared among the processes of a Dask cluster: what they return, and what becomes of one that kills them."""

import os
import signal

import pytest

from jaxmocap._results import InputError
from jaxmocap.pipeline import Failure, on_workers


def squared(number: int) -> int:
    if number == 3:
        os.kill(os.getpid(), signal.SIGKILL)
    if number == 4:
        raise InputError("four is no number")
    return number * number


def test_without_workers_calls_are_done_in_order_when_they_are_asked_for():
    asked: list[int] = []
    shared = on_workers(lambda number: asked.append(number) or -number, [1, 2, 5], lambda *_: 0, workers=1)
    assert asked == []
    assert list(shared) == [-1, -2, -5]


def test_less_than_no_workers_are_refused():
    with pytest.raises(InputError, match="the number of workers is -2; give 0 or more"):
        on_workers(squared, [1, 2], lambda *_: 0, workers=-2)


def test_a_call_that_kills_its_process_stops_no_other():
    distributed = pytest.importorskip("distributed")
    dask = pytest.importorskip("dask")
    died = lambda number, error: (number, type(error).__name__)  # noqa: E731
    with (
        dask.config.set({"distributed.scheduler.allowed-failures": 1}),
        distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster,
    ):
        found = list(on_workers(squared, [1, 2, 3, 4], died, scheduler=cluster.scheduler_address))
    assert sorted(found, key=str) == [(3, "KilledWorker"), (4, "InputError"), 1, 4]


def test_a_scheduler_that_does_not_answer_is_a_sentence():
    pytest.importorskip("distributed")
    dask = pytest.importorskip("dask")
    with dask.config.set({"distributed.comm.timeouts.connect": "200ms"}):
        with pytest.raises(InputError, match=r"no Dask scheduler answers at tcp://127.0.0.1:9"):
            list(on_workers(squared, [1], lambda *_: 0, scheduler="tcp://127.0.0.1:9"))
        with pytest.raises(InputError, match="no Dask scheduler answers at nonsense"):
            list(on_workers(squared, [1], lambda *_: 0, scheduler="nonsense"))


def test_a_failure_is_one_sentence_or_has_a_traceback():
    assert Failure.of(InputError("choose another.")) == ("choose another.", None)
    try:
        raise RuntimeError("out of luck")
    except RuntimeError as error:
        found = Failure.of(error)
    assert found.error == "RuntimeError: out of luck"
    assert found.traceback is not None
    assert "test_a_failure" in found.traceback
