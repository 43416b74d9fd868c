"""Exporters: a motion as a file of another program, one format per module."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from jaxmocap._results import InputError
from jaxmocap.motion import Motion

from ._blender import blender_command as blender_command, write_blender as write_blender
from ._bvh import write_bvh as write_bvh
from ._c3d import write_c3d as write_c3d
from ._colmap import write_colmap as write_colmap
from ._exporter import (
    Exporter as Exporter,
    ExportForm as ExportForm,
    Units as Units,
    Up as Up,
    checked_exporter as checked_exporter,
    export_motion as export_motion,
    silent,
)
from ._gait import gait as gait, write_gait as write_gait
from ._gait_record import Gait as Gait
from ._glb import write_glb as write_glb
from ._isb import IsbAngles as IsbAngles, isb_angles as isb_angles
from ._isb_tables import write_isb_csv as write_isb_csv, write_isb_mot as write_isb_mot
from ._opensim import write_mot as write_mot, write_trc as write_trc
from ._opensim_drive import write_driven_mot, write_driven_osim
from ._opensim_model import GEOMETRY, SETUP, write_osim as write_osim, write_osim_geometry, write_osim_setup
from ._tables import write_csv as write_csv, write_parquet as write_parquet
from ._usd import write_usd as write_usd

EXPORTERS: dict[str, Exporter] = {
    ".glb": Exporter(write_glb, units="m", up="y", fixed=True, rigged=True),
    ".bvh": Exporter(write_bvh, units="m", up="y", even=True, rigged=True),
    ".fbx": Exporter(write_blender, units="m", up="y", fixed=True, even=True, rigged=True),
    ".blend": Exporter(write_blender, units="m", up="z", fixed=True, even=True, rigged=True),
    ".c3d": Exporter(write_c3d, units="mm", even=True),
    ".trc": Exporter(write_trc, units="mm", up="y", even=True),
    ".mot": Exporter(write_mot, units="m", up="y", fixed=True),
    ".osim": Exporter(
        write_osim,
        units="m",
        up="y",
        fixed=True,
        beside={".mot": write_mot, SETUP: write_osim_setup, GEOMETRY: write_osim_geometry},
        driven=Exporter(write_driven_osim, units="m", up="y", fixed=True, beside={".mot": write_driven_mot}),
    ),
    ".csv": Exporter(write_csv),
    ".isb.csv": Exporter(write_isb_csv, units="m", up="y", fixed=True),
    ".isb.mot": Exporter(write_isb_mot, units="m", up="y", fixed=True),
    ".gait.json": Exporter(write_gait, units="m", up="y", fixed=True),
    ".parquet": Exporter(write_parquet),
    ".usd": Exporter(write_usd),
    ".usda": Exporter(write_usd),
    ".usdc": Exporter(write_usd),
    ".colmap": Exporter(write_colmap, resamples=False, folder=True),
}
"""By the suffix of the file."""


def export(
    result: Motion | str | Path,
    path: str | Path,
    *,
    units: Units | None = None,
    up: Up | None = None,
    frame_rate: float | None = None,
    actor: str | Path | None = None,
    mass: float | None = None,
    opensim_model: Sequence[str | Path] = (),
    rig: str | Path | None = None,
    mapping: str | Path | None = None,
    say: Callable[[str], None] | None = None,
) -> Path:
    """Write a motion, or that of a result folder, for another program; the format goes by the suffix. Returns `path`.

    `units` are "m", "cm" or "mm" and `up` is the vertical axis, "y" or "z"; `docs/conventions.md` has each format's
    own. `frame_rate` in frames per second resamples by interpolation. A GLB is written on the rig of the file that the
    character came from; `actor` names it where it is not the one the result remembers. With `rig`, a skinned file of
    somebody else's (Mixamo's, Unreal's), GLB, BVH, FBX and .blend hold that one instead, with its bones' names and
    lengths: limbs point as the person's, and feet stand where theirs do. `mapping` names joints that are not
    recognised, as for `Character.load`. An OSIM has its MOT, settings of inverse kinematics and a folder of meshes
    beside it, and `mass` is the person's in kilograms; it is guessed from the mesh otherwise. With `opensim_model`, a
    model of somebody else's (and its marker set, where that is a file of its own), OpenSim scales that one to the
    person and solves for our markers instead. `say` is told what is worth a sentence. Raises `InputError` for an
    unknown suffix, a file that exists, and what a format cannot hold; nothing is left behind then.
    """
    path, models = Path(path), tuple(Path(file) for file in opensim_model)
    actor, rig, mapping = (None if file is None else Path(file) for file in (actor, rig, mapping))
    form = ExportForm(
        path.name,
        frame_rate=frame_rate,
        actor=actor,
        mass=mass,
        opensim_model=models,
        rig=rig,
        mapping=mapping,
        say=say or silent,
    )
    if models and not checked_exporter(path, EXPORTERS, units, up, replace(form, opensim_model=())).driven:
        raise InputError(f"{path} is no .osim, for which alone a model of OpenSim's is driven; leave the model out.")
    export_motion(result, path, EXPORTERS, units, up, form)
    return path
