"""What every exporter is, what its format asks for, and how one is run on a motion or a result folder."""

import contextlib
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, NamedTuple, get_args

import numpy as np

from jaxmocap._files import atomic_folder, atomic_path
from jaxmocap._results import InputError
from jaxmocap.motion import Motion, continuous, turned

from ._prepare import frame_rate_of, mean_rate_of, resampled

Units = Literal["m", "cm", "mm"]
Up = Literal["y", "z"]
PER_METRE: dict[str, float] = {"m": 1.0, "cm": 100.0, "mm": 1000.0}
UNITS: tuple[str, ...] = get_args(Units)


def silent(sentence: str) -> None:
    """Say nothing."""


@dataclass(frozen=True)
class ExportForm:
    """How a file is to be written.

    Attributes:
        name: of the file, for messages.
        units: of lengths, "m", "cm" or "mm"; metres by default.
        up: the vertical axis, "y" or "z"; y by default.
        frame_rate: frames per second; None where the time between frames varies.
        actor: the character's own file, where one is named; None by default.
        mass: of the person, kilograms; None, the default, where it is not known.
        opensim_model: somebody else's model, and its marker set where that is a file of its own; empty by default.
        rig: a skinned file of somebody else's, where one is named; None by default.
        mapping: a file of the rig's joints and our bodies, where one is named; None by default.
        say: takes sentences that the user should know; nothing listens by default.
    """

    name: str
    units: Units = "m"
    up: Up = "y"
    frame_rate: float | None = None
    actor: Path | None = None
    mass: float | None = None
    opensim_model: tuple[Path, ...] = ()
    rig: Path | None = None
    mapping: Path | None = None
    say: Callable[[str], None] = silent

    @property
    def per_metre(self) -> float:
        """Tell what lengths in metres are multiplied by."""
        return PER_METRE[self.units]


Write = Callable[[Motion, Path, ExportForm], None]


class Exporter(NamedTuple):
    """A format: how it is written, and what it asks for.

    The motion comes to `write` with the vertical axis and the frame rate of the form and with joint angles that do not
    jump; only its lengths are still metres.

    Attributes:
        write: `write(motion, path, form)` writes one file, or a folder, at a path that is free.
        units: of lengths where the user does not say; metres by default.
        up: the vertical axis where the user does not say; None leaves the motion's.
        fixed: whether the format defines `units` and `up`; not by default.
        even: whether the time between all frames must be the same; not by default.
        resamples: whether the frame rate may change, unlike where frames must stay those of the videos; by default it
            may.
        folder: whether a folder is written instead of a file; not by default.
        beside: what else is written, by how its name ends in place of the suffix: a file if that has a suffix, a folder
            otherwise. Nothing by default.
        rigged: whether it can be written on a rig of somebody else's; not by default.
        driven: what is written instead where the user names a model of their own; None if that means nothing here.
    """

    write: Write
    units: Units = "m"
    up: Up | None = None
    fixed: bool = False
    even: bool = False
    resamples: bool = True
    folder: bool = False
    beside: Mapping[str, Write] = {}
    rigged: bool = False
    driven: "Exporter | None" = None

    def parts(self, path: Path) -> dict[Path, Write]:
        """List what is written for a path, the path itself first."""
        return {path: self.write} | {path.with_name(path.stem + ending): write for ending, write in self.beside.items()}


def export_motion(
    result: Motion | str | Path,
    path: str | Path,
    exporters: Mapping[str, Exporter],
    units: Units | None,
    up: Up | None,
    form: ExportForm,
) -> ExportForm:
    """Do what `export` says, as `form` has it but for its name, units and axis; return how the file was written.

    Without `units` and `up` these are the format's own.
    """
    path = Path(path)
    exporter = checked_exporter(path, exporters, units, up, form)
    motion = result if isinstance(result, Motion) else Motion.load(result)
    form = replace(form, name=path.name, units=units or exporter.units, up=up or exporter.up or _up(motion))
    motion = continuous(turned(motion, form.up))
    rate = frame_rate_of(motion)
    if form.frame_rate is not None and not (rate and math.isclose(form.frame_rate, rate, rel_tol=1e-6)):
        motion = resampled(motion, form.frame_rate)
    elif rate is None and exporter.even:
        rate = mean_rate_of(motion)
        form.say(f"{path}: the time between frames varies, so poses are interpolated to {rate:.2f} frames per second.")
        motion = resampled(motion, rate)
    form = replace(form, frame_rate=form.frame_rate or rate)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with contextlib.ExitStack() as stack:
            for part, write in exporter.parts(path).items():
                folder = exporter.folder if part == path else not part.suffix
                temporary = stack.enter_context(atomic_folder(part) if folder else atomic_path(part))
                write(motion, temporary, replace(form, name=part.name))
    except OSError as error:
        raise InputError(f"{path} cannot be written ({error.strerror or error}); choose another place.") from error
    return form


def checked_exporter(
    path: Path,
    exporters: Mapping[str, Exporter],
    units: str | None,
    up: str | None,
    form: ExportForm,
) -> Exporter:
    """Find the exporter of a path. Raises `InputError` where nothing can be written there, or not in this way."""
    frame_rate, mass = form.frame_rate, form.mass
    both = "".join(path.suffixes[-2:]).lower()
    exporter = exporters.get(both) or exporters.get(path.suffix.lower())
    if exporter is None:
        found = f"the suffix {path.suffix}" if path.suffix else "no suffix"
        raise InputError(f"{path} has {found}, which names no format; expected one of {', '.join(exporters)}.")
    if form.opensim_model and exporter.driven:
        exporter = exporter.driven
    for part in exporter.parts(path):
        if part.exists():
            raise InputError(f"{part} exists already; choose a new file.")
    if units is not None and units not in UNITS:
        raise InputError(f"units are {units!r}; expected one of {', '.join(UNITS)}.")
    if up is not None and up not in ("y", "z"):
        raise InputError(f"up is {up!r}; expected y or z.")
    if frame_rate is not None and not (np.isfinite(frame_rate) and frame_rate > 0):
        raise InputError(f"the frame rate is {frame_rate:g}; expected frames per second, more than 0.")
    if mass is not None and not (np.isfinite(mass) and mass > 0):
        raise InputError(f"the mass is {mass:g}; expected the person's in kilograms, more than 0.")
    given = [("units", units, exporter.units), ("up", up, exporter.up)]
    for name, value, own in given:
        if exporter.fixed and value not in (None, own):
            raise InputError(f"{path}: {path.suffix} files have {name} = {own} by definition; leave {name} out.")
    if frame_rate is not None and not exporter.resamples:
        raise InputError(f"{path} has a camera for every frame of the videos; leave the frame rate out.")
    _check_rig(path, exporter, form)
    return exporter


def _check_rig(path: Path, exporter: Exporter, form: ExportForm) -> None:
    """Raise `InputError` where a path cannot be written on somebody else's rig, or not in this way."""
    if form.rig is None and form.mapping is not None:
        raise InputError(f"the mapping {form.mapping} names the joints of a rig, and none is given; name the rig too.")
    if form.rig is not None and not exporter.rigged:
        raise InputError(
            f"{path} is not written on a rig, as .glb, .bvh, .fbx and .blend are; leave the rig out for it."
        )
    if form.rig is not None and form.actor is not None:
        raise InputError(
            f"{path}: the actor's file is of the person who was tracked, the rig is somebody else's; name one of them."
        )


def _up(motion: Motion) -> Up:
    return "z" if motion.up == "z" else "y"
