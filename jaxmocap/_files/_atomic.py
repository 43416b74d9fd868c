"""Files and folders that appear whole or not at all.

A file is written under a temporary name in its own folder, flushed to disk and renamed. A reader therefore sees the
old file or the new one, and a run that dies in the middle leaves neither a half-written file nor a broken result.
"""

import contextlib
import csv
import io
import json
import math
import os
import secrets
import shutil
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np


@contextlib.contextmanager
def atomic_path(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Give a temporary path beside `path`, with the same suffix, to code that writes a file by name (a video encoder).

    When the block ends well, the file is flushed to disk and renamed to `path`; when it raises, the file is deleted.
    Its folder is made if need be.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{secrets.token_hex(6)}.partial.{path.name}")
    try:
        yield temporary
        _flush(temporary)
        os.replace(temporary, path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
    _flush(path.parent)


def write_bytes(path: str | os.PathLike[str], data: bytes) -> None:
    """Write `data` to `path` atomically."""
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)


def write_text(path: str | os.PathLike[str], text: str) -> None:
    """Write `text` to `path` atomically, as UTF-8 with the line ends it has."""
    write_bytes(path, text.encode("utf-8"))


def write_json(path: str | os.PathLike[str], value: Any) -> None:
    """Write `value` to `path` atomically as indented JSON. Values that are not finite become null."""
    write_text(path, json_text(value))


def write_csv(path: str | os.PathLike[str], head: Sequence[str], rows: Iterable[Iterable[Any]]) -> None:
    """Write a table to `path` atomically, its first row the `head`; None becomes an empty cell."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(head)
    writer.writerows(rows)
    write_text(path, text.getvalue())


def npz_bytes(arrays: Mapping[str, np.ndarray]) -> bytes:
    """Compress named arrays as an npz file holds them; equal arrays give equal bytes.

    Raises `TypeError` for an array of Python objects, which only a pickle could hold.
    """
    for name, values in arrays.items():
        if values.dtype.hasobject:
            raise TypeError(f"the array {name} holds Python objects")
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)  # pyright: ignore[reportArgumentType]
    return buffer.getvalue()


def json_text(value: Any) -> str:
    """Write indented JSON; values that are not finite become null."""
    return json.dumps(plain(value), indent=2, allow_nan=False, ensure_ascii=False) + "\n"


@contextlib.contextmanager
def atomic_folder(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Make an empty folder beside `path`; rename it to `path` if the block ends well, delete it if it raises.

    `path` must not exist, or be an empty folder; otherwise `OSError`, with nothing changed.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{secrets.token_hex(6)}.partial.{path.name}")
    temporary.mkdir()
    try:
        yield temporary
        for entry in temporary.rglob("*"):
            _flush(entry)
        os.replace(temporary, path)
    except BaseException:
        shutil.rmtree(temporary, ignore_errors=True)
        raise
    _flush(path.parent)


def keep_newest(folder: Path, most: int) -> None:
    """Delete the npz files of a folder that have not been used for longest, where all take more than `most` bytes."""
    files = sorted(folder.glob("*.npz"), key=lambda path: path.stat().st_mtime, reverse=True)
    total = 0
    for path in files:
        total += path.stat().st_size
        if total > most:
            path.unlink(missing_ok=True)


def plain(value: Any) -> Any:
    """Turn NumPy and JAX scalars, arrays, tuples and paths in `value` into what JSON knows; NaN and infinity into None.

    Raises `TypeError` for anything else.
    """
    if value is None or isinstance(value, str | bool | int):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if isinstance(value, Mapping):
        return {str(name): plain(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if hasattr(value, "__array__"):
        return plain(np.asarray(value).tolist())
    raise TypeError(f"{type(value).__name__} cannot be written as JSON")


def _flush(path: Path) -> None:
    """Ask the operating system to put a file or a folder on disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
