"""Cameras from elsewhere for a capture on disk: copied into it, and named in `capture.toml`."""

import shutil
from pathlib import Path

from jaxmocap._files import atomic_folder, atomic_path
from jaxmocap._results import InputError
from jaxmocap.camera import read_cameras
from jaxmocap.capture import Capture

from ._in_place import free_name, name_cameras, refuse_named_cameras


def adopt_cameras(path: str | Path, cameras: str | Path, *, replace: bool = False) -> Path:
    """Copy a calibration of any form that `read_cameras` takes into the capture at `path` and name it there; the copy.

    Raises `InputError`, with nothing changed, if it does not fit the capture's cameras, frames and video sizes, or if
    `capture.toml` names cameras already, unless `replace`; the old ones stay where they are.
    """
    file, source = refuse_named_cameras(path, replace), Path(cameras)
    capture = Capture.open(file, with_cameras=False)
    read_cameras(
        source, capture.camera_names, capture.num_frames, capture.sizes, capture.video_frames, capture.metres_per_unit
    )
    copy = free_name(file.parent, "cameras", "" if source.is_dir() else "".join(source.suffixes[-2:]))
    try:
        if source.is_dir():
            with atomic_folder(copy) as partial:
                shutil.copytree(source, partial, dirs_exist_ok=True)
        else:
            with atomic_path(copy) as partial:
                shutil.copyfile(source, partial)
        name_cameras(file, copy.name)
    except OSError as error:
        raise InputError(f"{copy} cannot be written: {error.strerror}") from error
    return copy
