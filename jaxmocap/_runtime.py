"""The process: versions, where compiled programs are kept, how many CPU devices there are, and its memory."""

import ctypes
import os
import platform
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TypeVar

_Item = TypeVar("_Item")
_Answer = TypeVar("_Answer")
_RECORDED = ("jaxmocap", "jax", "jaxlib", "equinox", "optimistix", "numpy", "opencv-python-headless", "av")
_EMITTERS, _VECTORS = "xla_cpu_use_fusion_emitters", "xla_cpu_prefer_vector_width"
_SHORTEST_COMPILATION = 0.0  # seconds: hundreds of small programs take longer to compile than to read


def configure() -> None:
    """Keep compiled programs from run to run, and let JAX see every core. Call it before JAX is imported.

    The command line does this by itself. The cache is the user's cache folder; the environment variables
    `JAX_COMPILATION_CACHE_DIR`, `JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS`, `JAX_NUM_CPU_DEVICES` and
    `JAXMOCAP_PROGRAMS` (the folder of traced programs; empty: none are kept) and `XLA_FLAGS` go before. Where
    JAX runs on an accelerator the number of CPU devices changes nothing. If JAX is imported already, the cache is still
    set, but the number of devices no longer.
    """
    settings = {
        "jax_compilation_cache_dir": str(cache_folder("xla")),
        "jax_persistent_cache_min_compile_time_secs": _SHORTEST_COMPILATION,
        "jax_num_cpu_devices": cores(),
        "jaxmocap_programs": str(cache_folder("programs")),
    }
    for name, value in settings.items():
        os.environ.setdefault(name.upper(), str(value))
    compile_sooner()
    if "jax" in sys.modules:
        import jax

        for name in ("jax_compilation_cache_dir", "jax_persistent_cache_min_compile_time_secs"):
            jax.config.update(name, type(settings[name])(os.environ[name.upper()]))


def compile_sooner() -> None:
    """Let XLA make loops for CPUs in its older way, which compiles our programs in about 0.6 of the time.

    What runs for long is excepted by `quick_loops`. Results differ by rounding.
    """
    flags = os.environ.get("XLA_FLAGS", "")
    if _EMITTERS not in flags and _emitters_known():
        os.environ["XLA_FLAGS"] = f"{flags} --{_EMITTERS}=false".strip()


def quick_loops() -> dict[str, bool | int]:
    """List compiler options under which XLA makes loops in its newer way and uses whole vectors.

    Scores are then computed up to 1.5 times as fast. All 512 bits of a vector, where the processor has them (XLA by
    itself uses 256), save another tenth.
    """
    if not _emitters_known():
        return {}
    return {_EMITTERS: True} | ({_VECTORS: 512} if _wide_vectors() else {})


def _wide_vectors() -> bool:
    """Whether the processor has AVX-512; only Linux says."""
    about = Path("/proc/cpuinfo")
    return about.is_file() and " avx512f " in about.read_text()


def _emitters_known() -> bool:
    """Whether this jaxlib is one with which these options were measured: XLA ends the process over a flag that it does
    not know."""
    return versions(("jaxlib",))["jaxlib"].startswith("0.10.")


def release_memory() -> None:
    """Give memory that is free back to the system, where the C library (glibc) can: compiling leaves much behind."""
    if sys.platform == "linux":
        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
        if trim is not None:
            trim(0)


def versions(packages: Sequence[str] = _RECORDED) -> dict[str, str]:
    """List versions of Python and of packages, by default of those that a result depends on; "not installed" where
    absent."""
    found = {"python": platform.python_version()}
    for package in packages:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "not installed"
    return found


def cores() -> int:
    """Count the cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def side_by_side(function: Callable[[_Item], _Answer], items: Sequence[_Item]) -> Iterator[_Answer]:
    """Call a function of every item in threads, one per core, and give the answers in order.

    What JAX holds for the calling thread alone (`jax.enable_x64`, `jax.default_device`, `jax.default_matmul_precision`
    as contexts) holds in the threads, too.
    """
    import jax

    held = ("jax_enable_x64", "jax_default_device", "jax_default_matmul_precision")
    wide, device, precision = (getattr(jax.config, name) for name in held)

    def one(item: _Item) -> _Answer:
        with jax.enable_x64(wide), jax.default_device(device), jax.default_matmul_precision(precision):
            return function(item)

    with ThreadPoolExecutor(max(min(cores(), len(items)), 1)) as pool:
        yield from pool.map(one, items)


def cache_folder(name: str) -> Path:
    """Name a folder of ours in the platform's place for what may be deleted at any time."""
    from platformdirs import user_cache_path

    return user_cache_path("jaxmocap", appauthor=False, opinion=False) / name


@dataclass
class Clock:
    """Adds up what each stage takes."""

    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time what is inside."""
        begin = time.perf_counter()
        yield
        self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - begin
