"""Lowered programs are traced once, never taken from a file that is not theirs, and give the bits of tracing."""

import gc
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmocap._cache import (
    _exported,
    _programs,
    cached_jit,
    free_programs,
    optimised_jit,
    preload_programs,
    programs_recorded,
    small_jit,
)
from jaxmocap.character import Pose

TRACES: list[str] = []


@pytest.fixture
def folder(tmp_path, monkeypatch):
    if jax.default_backend() != "cpu":
        pytest.skip("programs are kept on a CPU only")
    monkeypatch.setenv(_programs.FOLDER, str(tmp_path / "programs"))
    TRACES.clear()
    return tmp_path / "programs"


def moved(pose, by, times, key):
    TRACES.append("moved")
    noise = jax.random.normal(key, pose.angles.shape)
    return Pose(pose.root, jnp.sin(pose.angles * times) + by * noise), jnp.linalg.norm(noise)


def arguments(size=5, times=3):
    return Pose(jnp.eye(4), jnp.linspace(0.0, 1.0, size)), jnp.float32(0.3), times, jax.random.key(7)


def another_process(*args):
    """What a process of its own would find: nothing in memory, the folder as it is."""
    return cached_jit(moved)(*args)


def same(one, two):
    for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(two), strict=True):
        assert a.dtype == b.dtype
        assert np.asarray(a).tobytes() == np.asarray(b).tobytes()
    assert jax.tree.structure(one) == jax.tree.structure(two)


def test_a_program_is_traced_once_and_gives_the_bits_of_tracing(folder):
    first = another_process(*arguments())
    assert len(TRACES) == 1
    function = cached_jit(moved)
    again = [function(*arguments()) for _ in range(3)]
    assert len(TRACES) == 1
    plain = eqx.filter_jit(moved)(*arguments())
    for found in (first, *again):
        same(found, plain)
    assert isinstance(first[0], Pose)


def slowly_traced(values):
    TRACES.append("slowly")
    time.sleep(0.2)
    return jnp.cos(values)


def test_what_two_threads_ask_for_at_once_is_traced_once(folder):
    function = cached_jit(slowly_traced)
    with ThreadPoolExecutor(2) as pool:
        found = list(pool.map(function, [jnp.arange(4.0)] * 2))
    assert TRACES == ["slowly"]
    same(*found)


def test_the_compiler_is_given_the_options(folder, monkeypatch):
    """With an option it knows the answer is the same to rounding; one that it does not know reaches it."""
    plain = cached_jit(moved)(*arguments())
    for where in (str(folder), ""):  # kept, and traced
        monkeypatch.setenv(_programs.FOLDER, where)
        found = optimised_jit(moved)(*arguments())
        np.testing.assert_allclose(found[0].angles, plain[0].angles, rtol=1e-5)
        with pytest.raises(jax.errors.JaxRuntimeError, match="xla_no_such_option"):
            cached_jit(moved, lambda: {"xla_no_such_option": True})(*arguments())


def test_other_shapes_and_static_values_are_other_programs(folder):
    another_process(*arguments())
    for other in (arguments(size=6), arguments(times=4), arguments(times=3.0)):
        before = len(TRACES)
        found = another_process(*other)
        assert len(TRACES) == before + 1
        same(found, eqx.filter_jit(moved)(*other))


def test_a_program_of_another_version_is_not_used(folder, monkeypatch):
    another_process(*arguments())
    monkeypatch.setattr(_exported, "code_hash", lambda: "another source")
    another_process(*arguments())
    assert len(TRACES) == 2
    monkeypatch.setattr(_exported, "versions", lambda packages: {"jax": "another"})
    another_process(*arguments())
    assert len(TRACES) == 3
    with jax.default_matmul_precision("highest"):
        another_process(*arguments())
    assert len(TRACES) == 4


def test_a_damaged_program_is_traced_again(folder):
    whole = another_process(*arguments())
    (file,) = folder.glob("*.npz")
    content = file.read_bytes()
    for broken in (b"", content[:-200], b"text" * 100, content[:2000] + bytes(500) + content[2500:]):
        file.write_bytes(broken)
        before = len(TRACES)
        same(another_process(*arguments()), whole)
        assert len(TRACES) == before + 1
        same(another_process(*arguments()), whole)
        assert len(TRACES) == before + 1


def test_a_folder_that_cannot_be_written_does_not_matter(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv(_programs.FOLDER, str(tmp_path / "file" / "below"))
    same(another_process(*arguments()), eqx.filter_jit(moved)(*arguments()))


def test_what_has_no_name_in_another_run_and_what_is_being_traced_is_not_kept(folder):
    def apply(function, x):
        return function(x)

    assert float(cached_jit(apply)(lambda x: 2 * x, jnp.float32(3.0))) == 6
    assert float(jax.grad(cached_jit(lambda x: x**2))(3.0)) == 6
    assert not list(folder.glob("*"))


def test_programs_are_loaded_ahead(folder):
    with programs_recorded({"capture": "one"}):
        first = another_process(*arguments())
    preload_programs({"capture": "another"})
    assert not _programs._ahead
    preload_programs({"capture": "one"})
    assert len(_programs._ahead) == 1
    with programs_recorded({"capture": "one"}):
        same(another_process(*arguments()), first)
    assert len(TRACES) == 1
    assert not _programs._ahead


@pytest.mark.skipif(not Path("/proc/self/maps").is_file(), reason="memory maps are counted on Linux only")
@pytest.mark.slow
def test_compiled_programs_are_dropped_before_memory_maps_run_out(folder, monkeypatch):
    def maps():
        gc.collect()
        return Path("/proc/self/maps").read_bytes().count(b"\n")

    kept, sizes = cached_jit(moved), range(2, 42)
    before = maps()
    answers = [kept(*arguments(size)) for size in sizes]
    full = maps()
    _programs.make_room()
    assert maps() > before + 0.9 * (full - before) > before + len(sizes)
    monkeypatch.setattr(_programs, "MOST_MAPS", full - 1)
    _programs.make_room()
    assert maps() < before + 0.5 * (full - before)
    same(answers, [kept(*arguments(size)) for size in sizes])


def test_only_our_own_programs_are_dropped(folder):
    """Whoever uses the package keeps what they compiled."""
    theirs = jax.jit(lambda values: 2 * jnp.sort(values))
    theirs(jnp.ones(3))
    ours = cached_jit(moved)
    before = ours(*arguments(5))
    assert len(ours.programs) == 1
    free_programs()
    assert len(ours.programs) == 0
    assert theirs._cache_size() == 1
    same([before], [ours(*arguments(5))])


@pytest.mark.parametrize("cpu", [True, False])
def test_a_program_of_small_steps_runs_on_the_cpu_beside_an_accelerator(monkeypatch, cpu):
    def halved(values, named, times):
        return {"left": values / 2**times, "name": named}

    program, values = small_jit(halved), jnp.arange(3.0)
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    asked, devices = [], jax.local_devices

    def local_devices(*args, backend=None):
        if backend == "cpu":
            asked.append(backend)
            if not cpu:
                raise RuntimeError("JAX may use the accelerator only")
        return devices(*args)

    monkeypatch.setattr(jax, "local_devices", local_devices)
    found = program(values, "half", 2)
    assert asked == ["cpu"]
    assert found["name"] == "half"
    np.testing.assert_array_equal(found["left"], [0, 0.25, 0.5])
    assert isinstance(found["left"], jax.Array)
    slope = jax.grad(lambda x: program(x, "half", 2)["left"].sum())(values)
    np.testing.assert_array_equal(slope, 0.25)  # inside another program it is traced like any other
