"""TRC and MOT: markers and joint angles for OpenSim."""

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from jaxmocap._files import write_text
from jaxmocap.motion import Motion

from ._exporter import ExportForm
from ._marker_set import marker_set
from ._neutral_body import REST_FROM_OPENSIM
from ._prepare import euler_angles, neutral_angles

PELVIS = ("pelvis_tilt", "pelvis_list", "pelvis_rotation", "pelvis_tx", "pelvis_ty", "pelvis_tz")


def opensim_name(name: str) -> str:
    """Replace what OpenSim refuses in the name of anything: blanks and some signs."""
    return re.sub(r"[\\*+\s/]", "_", name)


def write_trc(motion: Motion, path: Path, form: ExportForm) -> None:
    """Write virtual markers, on joints and on the skin, at the motion's own times."""
    markers = marker_set(motion.character)
    places, rate = form.per_metre * markers.along(motion), form.frame_rate or 30.0
    write_text(path, trc_text(form.name, markers.names, motion.timestamps, places, form.units, rate))


def trc_text(
    name: str,
    markers: Sequence[str],
    timestamps: Float[np.ndarray, " frame"],
    places: Float[np.ndarray, "frame marker 3"],
    units: str,
    rate: float,
) -> str:
    """Write down a TRC, tabs between columns; `places` are in `units`, `rate` is in frames per second."""
    count = len(places)
    labels = [f"{axis}{number}" for number in range(1, len(markers) + 1) for axis in "XYZ"]
    stated = {"DataRate": f"{rate:.6g}", "CameraRate": f"{rate:.6g}", "NumFrames": count, "NumMarkers": len(markers)}
    stated |= {"Units": units, "OrigDataRate": f"{rate:.6g}", "OrigDataStartFrame": 1, "OrigNumFrames": count}
    rows = [
        ["PathFileType", "4", "(X/Y/Z)", name],
        list(stated),
        [str(value) for value in stated.values()],
        ["Frame#", "Time", *(column for marker in markers for column in (marker, "", ""))],
        ["", "", *labels],
        [],
    ]
    for number, (seconds, row) in enumerate(zip(timestamps, places.reshape(count, -1), strict=True), start=1):
        rows.append([str(number), f"{seconds:.6f}", *(f"{value:.6f}" for value in row)])
    return "\n".join("\t".join(row) for row in rows) + "\n"


def write_mot(motion: Motion, path: Path, form: ExportForm) -> None:
    """Write coordinates at the motion's own times.

    The pelvis has OpenSim's (tilt, list and rotation, about z, x and y in this order; metres), the joints have our
    degrees of freedom, in degrees from the neutral body. OpenSim's pelvis looks along x; z is its right.
    """
    values = coordinates_of(motion)
    values[:, :3], values[:, 6:] = np.degrees(values[:, :3]), np.degrees(values[:, 6:])
    rate = "the time between frames varies" if form.frame_rate is None else f"{form.frame_rate:.6g} frames per second"
    notes = [
        f"Metres and degrees, y up, {rate}.",
        "Joint angles are measured from the neutral body: arms straight out to the sides, palms down, legs straight.",
    ]
    names = (*PELVIS, *map(opensim_name, motion.character.skeleton.angle_names))
    write_text(path, mot_text(form.name, notes, names, motion.timestamps, values))


def mot_text(
    name: str,
    notes: Sequence[str],
    names: Sequence[str],
    timestamps: Float[np.ndarray, " frame"],
    values: Float[np.ndarray, "frame column"],
) -> str:
    """Write down a MOT in degrees: a head with notes, then a column of seconds and one per name."""
    head = [name, "version=1", f"nRows={len(values)}", f"nColumns={1 + len(names)}", "inDegrees=yes", "", *notes, ""]
    lines = [*head, "endheader", "\t".join(["time", *names])]
    for seconds, row in zip(timestamps, values, strict=True):
        lines.append("\t".join([f"{seconds:.6f}", *(f"{value:.6f}" for value in row)]))
    return "\n".join(lines) + "\n"


def coordinates_of(motion: Motion) -> Float[np.ndarray, "frame dof"]:
    """Compute OpenSim's coordinates of the pelvis and the joint angles from the neutral body, radians and metres."""
    tilt_list_rotation = euler_angles(motion.root[:, :3, :3] @ REST_FROM_OPENSIM, "ZXY")
    return np.concatenate([tilt_list_rotation, motion.joints[:, 0].astype(np.float64), neutral_angles(motion)], axis=1)
