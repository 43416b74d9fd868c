"""A motion on disk: `motion.npz`, which holds what was found, and `report.json`, which is for people.

The seconds that a run took are in `report.json` alone: the same run gives the same `motion.npz`, byte for byte.
"""

import contextlib
import json
import os
import tokenize
import zipfile
import zlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from jaxmocap._files import atomic_path, json_text, npz_bytes
from jaxmocap._results import InputError

from ._arrays import SCHEMA_VERSION, WALL_CLOCK, motion_arrays, motion_of
from ._motion import Motion

_DAMAGE = (
    zipfile.BadZipFile,
    zlib.error,
    ValueError,
    EOFError,
    OSError,
    NotImplementedError,
    MemoryError,
    SyntaxError,  # these two: numpy parses the header of an array before it compares the checksum
    tokenize.TokenError,
)


def save(motion: Motion, folder: str | os.PathLike[str], *, overwrite: bool = False) -> Path:
    """Write both files; `motion.npz` last, so that it never stands beside an older report."""
    folder = Path(folder)
    path = folder / "motion.npz"
    if path.exists() and not overwrite:
        raise InputError(
            f"The folder {folder} already holds the result of another run; choose another, delete it, or say "
            "overwrite=True."
        )
    created = not folder.exists()
    data, report = npz_bytes(motion_arrays(motion)), json_text(_report(motion))
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with atomic_path(path) as data_file, atomic_path(folder / "report.json") as report_file:
            data_file.write_bytes(data)
            report_file.write_text(report, encoding="utf-8")
    except OSError as error:
        if created:
            with contextlib.suppress(OSError):
                folder.rmdir()
        raise InputError(f"The result cannot be written to {folder} ({error.strerror or error}).") from error
    return folder


def load(folder: str | os.PathLike[str]) -> Motion:
    """Read `motion.npz`, and from `report.json` beside it, where there is one, how long the run took."""
    path = Path(folder)
    if path.suffix != ".npz":
        path = path / "motion.npz"
    if not path.is_file():
        raise InputError(f"{folder} is not a result: there is no {path.name} in it; give the folder that track wrote.")
    arrays = read_npz(path)
    version = arrays.get("schema_version")
    if version is None or version.shape != () or version.dtype.kind not in "iu":
        raise InputError(f"{path} is not a motion of ours: it has no schema_version.")
    if version > SCHEMA_VERSION:
        raise InputError(
            f"{path} has schema version {int(version)}, this jaxmocap reads up to {SCHEMA_VERSION}; upgrade jaxmocap."
        )
    try:
        motion = motion_of(arrays)
        return replace(motion, provenance={**motion.provenance, **_wall_clock(path.with_name("report.json"))})
    except KeyError as error:
        raise InputError(f"{path} lacks the array {error.args[0]!r}; write the result again.") from error
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    except (ValueError, TypeError, IndexError) as error:
        raise InputError(f"{path} is damaged ({error}); write the result again.") from error


def _wall_clock(report: Path) -> dict[str, Any]:
    """Read the seconds in a report, if it can be read: nothing else depends on them."""
    try:
        found = json.loads(report.read_text(encoding="utf-8"))
        found = {**found, **found.get("provenance", {})}
    except (OSError, ValueError, TypeError, AttributeError, RecursionError):
        return {}
    return {name: found[name] for name in WALL_CLOCK if name in found}


def read_npz(path: str | os.PathLike[str]) -> dict[str, np.ndarray]:
    """Read all arrays of an npz file, without pickles.

    Raises `InputError` if it is missing, damaged, or not an npz.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"The file {path} does not exist.")
    try:
        with path.open("rb") as file:
            archive = np.load(file, allow_pickle=False)
            if not isinstance(archive, np.lib.npyio.NpzFile):
                raise InputError(f"{path} is not an npz file; it holds a single array.")
            return {name: archive[name] for name in archive.files}
    except InputError:
        raise
    except _DAMAGE as error:
        raise InputError(
            f"{path} cannot be read as an npz file ({error}); it is damaged or of another kind."
        ) from error


def _report(motion: Motion) -> dict[str, Any]:
    """Everything but the numbers of the motion itself: how it was made, and a verdict per frame."""
    verdicts = [
        {
            "frame": int(frame),
            "timestamp": float(motion.timestamps[index]),
            "status": str(motion.status[index]),
            "confidence": float(motion.confidence[index].mean()),
            "energy": {name: float(values[index]) for name, values in motion.energy.items()},
        }
        for index, frame in enumerate(motion.frames)
    ]
    counts = {f"{name}_frames": int((motion.status == name).sum()) for name in ("doubtful", "lost")}
    summary = {"schema_version": SCHEMA_VERSION, "character": motion.character.name, "frames": len(motion)}
    return {**summary, **counts, "provenance": motion.provenance, "verdicts": verdicts}
