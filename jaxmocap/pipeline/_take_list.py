"""From what a batch is given to its takes, and what of them is wrong before anything is done."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from jaxmocap._results import InputError
from jaxmocap.capture import config_path

from ._run_options import RunOptions
from ._take import CaptureTake, Take, TakeOptions, VideosTake
from ._take_file import TakeEntry, read_take_file


def takes_of(paths: Sequence[Path], common: TakeOptions) -> list[Take]:
    """Make a take of every capture folder (or its `capture.toml`) and of every entry of other `.toml` files.

    What an entry does not say is as in `common`. Raises `InputError` for a list without takes, paths that are neither,
    and two takes of the same name.
    """
    found: list[Take] = []
    for path in paths:
        if path.suffix == ".toml" and path.name != "capture.toml" and path.is_file():
            found += [_listed(entry, path, common) for entry in read_take_file(path)]
        else:
            folder = config_path(path).resolve().parent
            found.append(CaptureTake(folder.name, folder, common))
    if not found:
        raise InputError("no take is given; name the folder of at least one capture, or a takes.toml")
    by_name: dict[str, Take] = {}
    for take in found:
        other = by_name.setdefault(take.name.casefold(), take)
        if other is not take:
            raise InputError(
                f"two takes are called '{take.name}' ({_places(other)} and {_places(take)}); give every take once, and "
                "takes of the same name other names in a takes.toml"
            )
    return found


def examine_takes(takes: Sequence[Take], out: Path) -> None:
    """Raise `InputError`, which names the take, for the first that cannot work."""
    for take in takes:
        try:
            take.examine(out / take.name)
        except InputError as error:
            raise InputError(f"take '{take.name}': {error}") from error


def _listed(entry: TakeEntry, file: Path, common: TakeOptions) -> Take:
    place = file.resolve().parent
    options = replace(common, **entry.given(place, "frames", "height", "actor"))
    if entry.capture is not None:
        folder = config_path(place / entry.capture).resolve().parent
        return CaptureTake(entry.name or folder.name, folder, options)
    assert entry.videos is not None
    assert entry.name is not None
    told: dict[str, Any] = dict(vars(options))
    if told.pop("settings"):
        raise InputError(
            f"{file}: take '{entry.name}' is made of videos, for which single settings cannot be changed; leave --set "
            "out, or list captures only"
        )
    told |= entry.given(place, "camera_distance", "focal", "offset", "scan", "person", "keypoints", "static")
    return VideosTake(entry.name, tuple(place / video for video in entry.videos), RunOptions(**told))


def _places(take: Take) -> str:
    return ", ".join(map(str, take.source))
