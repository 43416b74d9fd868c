"""What is done side by side: in order, in the caller's settings of JAX, and with the caller's errors."""

import threading

import jax
import jax.numpy as jnp
import pytest

import jaxmocap._runtime as runtime
from jaxmocap._runtime import side_by_side


@pytest.fixture
def two_cores(monkeypatch):
    monkeypatch.setattr(runtime, "cores", lambda: 2)


def test_answers_come_in_the_order_of_the_items_though_they_are_worked_out_together(two_cores):
    together = threading.Barrier(2)

    def one(item):
        together.wait(timeout=30)
        return -item

    assert list(side_by_side(one, (3, 1, 2, 5))) == [-3, -1, -2, -5]
    assert list(side_by_side(one, ())) == []


def test_settings_of_jax_that_hold_for_the_caller_hold_in_the_threads(two_cores):
    def kind(_):
        return jnp.ones(1).dtype, jax.config.jax_default_matmul_precision

    with jax.enable_x64(True), jax.default_matmul_precision("highest"):
        assert list(side_by_side(kind, range(3))) == [(jnp.float64, "highest")] * 3
    assert next(side_by_side(kind, [0]))[0] == jnp.ones(1).dtype


def test_what_goes_wrong_with_an_item_is_heard(two_cores):
    with pytest.raises(ZeroDivisionError):
        list(side_by_side(lambda item: 1 / item, [1, 0, 2]))
