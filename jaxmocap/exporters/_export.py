"""`export`: a motion or a result folder to a file of another program."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from jaxmocap._files import atomic_folder, atomic_path
from jaxmocap._results import InputError
from jaxmocap.motion import Motion, continuous, turned

from ._exporter import UNITS, Exporter, ExportForm, Units, Up
from ._prepare import frame_rate_of, resampled


def export_motion(
    result: Motion | str | Path,
    path: str | Path,
    exporters: Mapping[str, Exporter],
    *,
    units: Units | None,
    up: Up | None,
    frame_rate: float | None,
    actor: str | Path | None,
    say: Callable[[str], None] | None,
) -> ExportForm:
    """See `export`; also how the file was written."""
    path = Path(path)
    exporter = checked_exporter(path, exporters, units, up, frame_rate)
    motion = result if isinstance(result, Motion) else Motion.load(result)
    form = ExportForm(path.name, units or exporter.units, up or exporter.up or _up(motion))
    form = replace(form, actor=None if actor is None else Path(actor), say=say or form.say)
    motion = continuous(turned(motion, form.up))
    rate = frame_rate_of(motion)
    if frame_rate is not None and frame_rate != rate:
        motion = resampled(motion, frame_rate)
    elif rate is None and exporter.even:
        rate = 1 / float(np.mean(np.diff(motion.timestamps)))
        form.say(f"{path}: the time between frames varies, so poses are interpolated to {rate:.2f} frames per second.")
        motion = resampled(motion, rate)
    form = replace(form, frame_rate=frame_rate or rate)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if exporter.folder:
            with atomic_folder(path) as temporary:
                exporter.write(motion, temporary, form)
        else:
            with atomic_path(path) as temporary:
                exporter.write(motion, temporary, form)
    except OSError as error:
        raise InputError(f"{path} cannot be written ({error.strerror or error}); choose another place.") from error
    return form


def checked_exporter(
    path: Path, exporters: Mapping[str, Exporter], units: str | None, up: str | None, frame_rate: float | None
) -> Exporter:
    """The exporter of a path. Raises `InputError` where nothing can be written there, or not in this way."""
    exporter = exporters.get(path.suffix.lower())
    if exporter is None:
        found = f"the suffix {path.suffix}" if path.suffix else "no suffix"
        raise InputError(f"{path} has {found}, which names no format; expected one of {', '.join(exporters)}.")
    if path.exists():
        raise InputError(f"{path} exists already; choose a new file.")
    if units is not None and units not in UNITS:
        raise InputError(f"units are {units!r}; expected one of {', '.join(UNITS)}.")
    if up is not None and up not in ("y", "z"):
        raise InputError(f"up is {up!r}; expected y or z.")
    if frame_rate is not None and not (np.isfinite(frame_rate) and frame_rate > 0):
        raise InputError(f"the frame rate is {frame_rate:g}; expected frames per second, more than 0.")
    given = [("units", units, exporter.units), ("up", up, exporter.up)]
    for name, value, own in given:
        if exporter.fixed and value not in (None, own):
            raise InputError(f"{path}: {path.suffix} files have {name} = {own} by definition; leave {name} out.")
    if frame_rate is not None and not exporter.resamples:
        raise InputError(f"{path} has a camera for every frame of the videos; leave the frame rate out.")
    return exporter


def _up(motion: Motion) -> Up:
    return "z" if motion.up == "z" else "y"
