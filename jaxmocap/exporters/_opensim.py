"""TRC and MOT: markers and joint angles for OpenSim."""

from pathlib import Path

import numpy as np

from jaxmocap._files import write_text
from jaxmocap.motion import Motion

from ._exporter import ExportForm
from ._prepare import euler_angles, neutral_angles

_REST_FROM_OPENSIM = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
_PELVIS = ("pelvis_tilt", "pelvis_list", "pelvis_rotation", "pelvis_tx", "pelvis_ty", "pelvis_tz")


def write_trc(motion: Motion, path: Path, form: ExportForm) -> None:
    """Write the joints and landmarks as virtual markers at the motion's own times, tabs between columns."""
    rate = form.frame_rate or 30.0
    names, count = motion.joint_names, len(motion)
    labels = [f"{axis}{number}" for number in range(1, len(names) + 1) for axis in "XYZ"]
    stated = {"DataRate": f"{rate:.6g}", "CameraRate": f"{rate:.6g}", "NumFrames": count, "NumMarkers": len(names)}
    stated |= {"Units": form.units, "OrigDataRate": f"{rate:.6g}", "OrigDataStartFrame": 1, "OrigNumFrames": count}
    rows = [
        ["PathFileType", "4", "(X/Y/Z)", form.name],
        list(stated),
        [str(value) for value in stated.values()],
        ["Frame#", "Time", *(column for name in names for column in (name, "", ""))],
        ["", "", *labels],
        [],
    ]
    places = form.per_metre * motion.joints.reshape(count, -1).astype(np.float64)
    for number, (seconds, row) in enumerate(zip(motion.timestamps, places, strict=True), start=1):
        rows.append([str(number), f"{seconds:.6f}", *(f"{value:.6f}" for value in row)])
    write_text(path, "\n".join("\t".join(row) for row in rows) + "\n")


def write_mot(motion: Motion, path: Path, form: ExportForm) -> None:
    """Write coordinates at the motion's own times.

    The pelvis has OpenSim's (tilt, list and rotation, about z, x and y in this order; metres), the joints have our
    degrees of freedom, in degrees from the neutral body. OpenSim's pelvis looks along x; z is its right.
    """
    tilt_list_rotation = np.degrees(euler_angles(motion.root[:, :3, :3] @ _REST_FROM_OPENSIM, "ZXY"))
    pelvis = motion.joints[:, motion.joint_names.index("pelvis")].astype(np.float64)
    values = np.concatenate([tilt_list_rotation, pelvis, np.degrees(neutral_angles(motion))], axis=1)
    rate = "the time between frames varies" if form.frame_rate is None else f"{form.frame_rate:.6g} frames per second"
    lines = [
        form.name,
        "version=1",
        f"nRows={len(motion)}",
        f"nColumns={1 + values.shape[1]}",
        "inDegrees=yes",
        "",
        f"Metres and degrees, y up, {rate}.",
        "Joint angles are measured from the neutral body: arms straight out to the sides, palms down, legs straight.",
        "",
        "endheader",
        "\t".join(["time", *_PELVIS, *motion.character.skeleton.angle_names]),
    ]
    for seconds, row in zip(motion.timestamps, values, strict=True):
        lines.append("\t".join([f"{seconds:.6f}", *(f"{value:.6f}" for value in row)]))
    write_text(path, "\n".join(lines) + "\n")
