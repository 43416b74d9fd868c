"""Calibrating a capture on disk: a new folder with the cameras, and the line in `capture.toml` that names it."""

import dataclasses
import os
from pathlib import Path
from typing import Any

from jaxmocap._results import InputError
from jaxmocap.capture import Capture, config_path, read_config, with_cameras_line
from jaxmocap.motion import write_text

from ._calibrate import Calibration, calibrate


def calibrate_in_place(path: str | Path, *, replace: bool = False, **options: Any) -> Calibration:
    """Calibrate the capture at `path`, write the result to a folder in it and name that in `capture.toml`.

    Raises `InputError` if `capture.toml` names cameras already, unless `replace`; the old ones stay where they are.
    `options` are those of `calibrate`.
    """
    file = config_path(path)
    config, _ = read_config(file)
    if config is not None and config.cameras is not None and not replace:
        raise InputError(
            f"{file} names cameras already ({config.cameras!r}); remove the line, or use --replace, which leaves "
            "the old ones where they are"
        )
    capture = Capture.open(file, with_cameras=False)
    if not os.access(file.parent, os.W_OK):
        raise InputError(f"{file.parent} cannot be written to; copy the capture to a place of your own")
    folder = _free_folder(file.parent)
    with_cameras_line(_text(file), folder.name, file)  # before the long run: it may be refused
    calibration = calibrate(capture, **options)
    calibration.save(folder)
    write_text(file, with_cameras_line(_text(file), folder.name, file))
    return dataclasses.replace(calibration, folder=folder)


def _text(file: Path) -> str:
    return file.read_bytes().decode("utf-8")  # not read_text, which would change line ends


def _free_folder(parent: Path) -> Path:
    """`cameras`, or the first of `cameras-2`, `cameras-3`, ... that does not exist."""
    number, folder = 1, parent / "cameras"
    while folder.exists():
        number += 1
        folder = parent / f"cameras-{number}"
    return folder
