"""Is this installation sound: versions, devices, caches, codecs, optional parts, and a self-test."""

import os
import platform
import shutil
import tempfile
import time
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path
from typing import Any

import jax
from av.codec import Codec

from jaxmocap._runtime import cores, versions
from jaxmocap._types import Report
from jaxmocap.synthetic import make_capture, write_capture

from ._self_test import SelfTest, self_test
from ._track_capture import track_capture

PACKAGES = (
    *("jaxmocap", "jax", "jaxlib", "equinox", "optimistix", "lineax", "numpy", "scipy", "opencv-python-headless", "av"),
    *("pycolmap", "trimesh", "pygltflib", "ezc3d"),
)


EXTRAS = {
    "parquet": ("pyarrow", "export to .parquet"),
    "usd": ("usd-core", "export to .usd, .usda and .usdc"),
    "opensim": ("opensim", "export --opensim-model"),
    "view": ("viser", "view"),
    "rerun": ("rerun-sdk", "view --rerun"),
    "detect": ("ai-edge-litert", "detect"),
    "bodies": ("anny", "body --model anny"),
    "cluster": ("distributed", "--workers of batch and bench"),
    "bench": ("evosax", "the method cma-es of bench"),
}
"""Optional parts: the package each needs, and what it is for."""


_FRAMES, _SIZE = 6, (960, 540)
"""Of the film that is tracked ahead: until a frame brings no new program; what pictures are made to by default."""

WARMED = (
    "tracking two films of 960 x 540, the size that larger ones are made to, with keypoints and the quality normal; "
    "other sizes, qualities or numbers of cameras, and a person who is wider than a picture is high, compile their own"
)
"""What `warm_up` covers, and what it does not."""


_DECODERS = {"h264": "H.264", "hevc": "H.265 (HEVC)", "vp9": "VP9", "av1": "AV1", "libdav1d": "AV1", "mpeg4": "MPEG-4"}
_ENCODER = "libx264"


@dataclass(frozen=True)
class Diagnosis:
    """What `doctor` found. `problems` are sentences that say what is wrong and what to do; none, if all is well.

    `cache` has the `folder` of compiled programs (None where they are not kept), their `files` and `megabytes`, and
    whether it is `writable`. `extras` has a version, or None, per optional part. `tests` are those of the self-test,
    empty where it was left out. `warmed` is how many seconds it took to compile what tracking runs (`WARMED`), if that
    was asked.
    """

    versions: dict[str, str]
    system: dict[str, Any]
    devices: list[dict[str, Any]]
    cache: dict[str, Any]
    decoders: dict[str, bool]
    encodes: bool
    extras: dict[str, str | None]
    tests: list[SelfTest]
    problems: list[str]
    warmed: float | None = None


def doctor(*, test: bool = True, warm: bool = False, progress: Report | None = None) -> Diagnosis:
    """Examine this installation; a self-test of about ten seconds belongs to it, a minute the first time, when its
    programs are compiled. With `warm` what tracking runs is compiled too, for some minutes, so that the first film need
    not (`warm_up`). `progress(stage, done, total)` hears how far that is. Nothing is raised for what is wrong:
    `problems` says it."""
    tests = self_test(progress) if test else []
    warmed = warm_up(progress=progress) if warm else None
    found = versions(PACKAGES)
    devices = [_device(device) for device in jax.devices()]
    cache = cache_state()
    decoders: dict[str, bool] = {}
    for name, label in _DECODERS.items():
        decoders[label] = decoders.get(label, False) or _has_codec(name, "r")
    encodes = _has_codec(_ENCODER, "w")
    problems = [f"{name} is not installed; install jaxmocap again" for name in _missing(found)]
    problems += _unmet(found)
    if cache["folder"] is None:
        problems.append(
            "compiled programs are not kept: call jm.configure() before JAX is imported, or set "
            "JAX_COMPILATION_CACHE_DIR"
        )
    elif not cache["writable"]:
        problems.append(
            f"compiled programs cannot be kept in {cache['folder']}: every run compiles anew, for minutes; set "
            "JAX_COMPILATION_CACHE_DIR to a folder that can be written to"
        )
    if not decoders["H.264"] or not encodes:
        problems.append("PyAV cannot read or write H.264; install the wheel of av from PyPI")
    problems += [f"the self-test '{one.name}' failed: {one.said}" for one in tests if not one.passed]
    return Diagnosis(
        versions=found,
        system={
            "platform": platform.platform(),
            "cores": cores(),
            "memory_gb": _memory(),
            "free_disk_gb": round(shutil.disk_usage(_existing(Path(cache["folder"] or "."))).free / 1e9, 1),
        },
        devices=devices,
        cache=cache,
        decoders=decoders,
        encodes=encodes,
        extras={name: _version(package) for name, (package, _) in EXTRAS.items()},
        tests=tests,
        problems=problems,
        warmed=warmed,
    )


def warm_up(num_cameras: int = 2, progress: Report | None = None) -> float:
    """Compile what tracking `num_cameras` films runs, and keep it; return the seconds that took.

    A synthetic capture is tracked with keypoints, as `run` does. Another capture then finds nearly all its programs, as
    long as it is as large, the person fills no more than its shorter side, and the mesh has about as many faces as the
    built-in body. `progress(stage, done, total)` hears of the stages: most time goes into the first frames of "track".
    """
    begin = time.perf_counter()
    tell = progress or (lambda stage, done, total: None)
    with tempfile.TemporaryDirectory() as name:
        tell("film to compile with", 0, 1)
        film = write_capture(make_capture(_FRAMES, _SIZE, num_cameras), Path(name) / "film")
        tell("film to compile with", 1, 1)
        result, keypoints = Path(name) / "result", film / "keypoints"
        track_capture(film, result, detections=keypoints, overlays=False, cache=False, progress=progress)
    return time.perf_counter() - begin


def cache_state() -> dict[str, Any]:
    """Describe where compiled programs are kept: folder, files, megabytes, and whether it can be written to."""
    folder = jax.config.jax_compilation_cache_dir  # pyright: ignore[reportAttributeAccessIssue]
    if folder is None:
        return {"folder": None, "files": 0, "megabytes": 0.0, "writable": False}
    path = Path(folder)
    files = [entry for entry in path.rglob("*") if entry.is_file()] if path.is_dir() else []
    return {
        "folder": str(path),
        "files": len(files),
        "megabytes": round(sum(file.stat().st_size for file in files) / 1e6, 1),
        "writable": os.access(_existing(path), os.W_OK),
    }


def _device(device: Any) -> dict[str, Any]:
    """One of JAX's devices; the memory it may use, where it says so."""
    statistics = device.memory_stats() or {}
    limit = statistics.get("bytes_limit")
    return {
        "name": str(device),
        "kind": device.device_kind,
        "platform": device.platform,
        "memory_gb": None if limit is None else round(limit / 1e9, 1),
    }


def _has_codec(name: str, mode: str) -> bool:
    try:
        Codec(name, mode)  # pyright: ignore[reportArgumentType]
    except (ValueError, LookupError):
        return False
    return True


def _missing(found: dict[str, str]) -> list[str]:
    return [name for name, one in found.items() if one == "not installed" and name != "jaxmocap"]


def _unmet(found: dict[str, str]) -> list[str]:
    """List packages whose version jaxmocap was not made for."""
    try:
        from packaging.requirements import Requirement

        wanted = [Requirement(line) for line in requires("jaxmocap") or []]
    except (ImportError, PackageNotFoundError):
        return []  # nothing to compare with, or nothing that compares: packaging comes with pip's tools, not with us
    return [
        f"{one.name} is {found[one.name]}, jaxmocap needs {one.specifier}; run pip install '{one.name}{one.specifier}'"
        for one in wanted
        if one.name in found and found[one.name] != "not installed" and not one.marker
        if not one.specifier.contains(found[one.name], prereleases=True)
    ]


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def _memory() -> float | None:
    """Measure the machine's memory, gigabytes."""
    try:
        return round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 1e9, 1)
    except (AttributeError, ValueError, OSError):
        return None


def _existing(path: Path) -> Path:
    """Return the path or the nearest folder above it that exists."""
    while not path.exists() and path != path.parent:
        path = path.parent
    return path
