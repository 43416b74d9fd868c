"""Calibrating a capture on disk: a new folder with the cameras, and the line in `capture.toml` that names it."""

import dataclasses
import os
from pathlib import Path
from typing import Any

from jaxmocap._files import write_text
from jaxmocap._results import InputError
from jaxmocap.capture import Capture, config_path, read_config, with_cameras_line

from ._calibrate import Calibration, calibrate


def calibrate_in_place(path: str | Path, *, replace: bool = False, **options: Any) -> Calibration:
    """Calibrate the capture at `path`, write the result to a folder in it and name that in `capture.toml`.

    Raises `InputError` if `capture.toml` names cameras already, unless `replace`; the old ones stay where they are.
    `options` are those of `calibrate`.
    """
    file = refuse_named_cameras(path, replace)
    capture = Capture.open(file, with_cameras=False)
    folder = free_name(file.parent, "cameras")
    calibration = calibrate(capture, **options)
    calibration.save(folder)
    name_cameras(file, folder.name)
    return dataclasses.replace(calibration, folder=folder)


def refuse_named_cameras(path: str | Path, replace: bool) -> Path:
    """The `capture.toml`. Raises `InputError` if it names cameras, unless `replace`, or cannot be written."""
    file = config_path(path)
    config, _ = read_config(file)
    if config is not None and config.cameras is not None and not replace:
        raise InputError(
            f"{file} names cameras already ({config.cameras!r}); remove the line, or use --replace, which leaves "
            "the old ones where they are"
        )
    if not os.access(file.parent, os.W_OK):
        raise InputError(f"{file.parent} cannot be written to; copy the capture to a place of your own")
    return file


def name_cameras(file: Path, name: str) -> None:
    """Set the line `cameras` in `capture.toml`."""
    write_text(file, with_cameras_line(_text(file), name, file))


def free_name(parent: Path, stem: str, suffix: str = "") -> Path:
    """`cameras`, or the first of `cameras-2`, `cameras-3`, ... that does not exist."""
    number, path = 1, parent / f"{stem}{suffix}"
    while path.exists():
        number += 1
        path = parent / f"{stem}-{number}{suffix}"
    return path


def _text(file: Path) -> str:
    return file.read_bytes().decode("utf-8")  # not read_text, which would change line ends
