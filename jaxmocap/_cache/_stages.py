"""Stages that are the same for every run over a capture, kept from run to run: registration and appearance."""

import contextlib
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from jaxmocap._files import keep_newest
from jaxmocap._runtime import cache_folder

from ._records import UnreadableRecord, digest, read_records, write_records

LARGEST = 2 << 30
"""Bytes that cached stages may take; those that have not been used for longest go first."""


def cached_stage(name: str, inputs: Mapping[str, Any], make: Callable[[], Any], folder: Path | None = None) -> Any:
    """Return what `make()` returns, from disk if it has been made before of the same `inputs`.

    Whatever is wrong with the folder, the stage is made.
    """
    folder = cache_folder("stages") if folder is None else folder
    path = folder / f"{name}-{digest(dict(inputs))}.npz"
    with contextlib.suppress(OSError, UnreadableRecord):
        value = read_records(path)
        os.utime(path)
        return value
    value = make()
    with contextlib.suppress(OSError):
        folder.mkdir(parents=True, exist_ok=True)
        write_records(path, value)
        keep_newest(folder, LARGEST)
    return value
