"""ISB joint angles as a table that says how they are defined, and as a MOT."""

import csv
import io
from pathlib import Path

import numpy as np

from jaxmocap._files import write_text
from jaxmocap.motion import Motion

from ._exporter import ExportForm
from ._isb import IsbAngles, isb_angles
from ._isb_joints import NEUTRAL
from ._opensim import mot_text


def write_isb_csv(motion: Motion, path: Path, form: ExportForm) -> None:
    """Write a row per frame: each angle, its confidence and its standard deviation where that is known.

    Lines that begin with # say what each angle is; `pandas.read_csv(path, comment="#")` passes over them.
    """
    found = isb_angles(motion)
    table = {"frame": motion.frames.tolist(), "seconds": [f"{value:.6f}" for value in motion.timestamps]}
    table["status"] = motion.status.tolist()
    for number, name in enumerate(found.names):
        table[f"{name}_deg"] = _numbers(found.degrees[:, number])
        table[f"{name}_confidence"] = _numbers(found.confidence[:, number])
        if found.deviations is not None:
            table[f"{name}_sd_deg"] = _numbers(found.deviations[:, number])
    text = io.StringIO()
    text.writelines(f"# {line}\n" for line in [*_described(found), _uncertain(found)])
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(table)
    writer.writerows(zip(*table.values(), strict=True))
    write_text(path, text.getvalue())


def write_isb_mot(motion: Motion, path: Path, form: ExportForm) -> None:
    """Write the angles in degrees, their definitions in the head."""
    found = isb_angles(motion)
    write_text(path, mot_text(form.name, _described(found), found.names, motion.timestamps, found.degrees))


def _described(found: IsbAngles) -> list[str]:
    """Say what the angles are, a joint to a line."""
    lines = ["Joint angles in degrees, as recommended by the International Society of Biomechanics.", *NEUTRAL]
    lines.append("Sequences turn about axes that each move with the turns before; angles in their order:")
    for joint in found.joints:
        words = zip(joint.angles, joint.order, joint.signs, joint.positive, strict=True)
        angles = ", ".join(f"{name} ({'-' * (sign < 0)}{axis}) + {word}" for name, axis, sign, word in words)
        frames = f"{joint.distal} in {joint.proximal or 'the laboratory'}"
        lines.append(
            f"{joint.name}: {frames}, {joint.order[0]}-{joint.order[1]}-{joint.order[2]}: {angles}; {joint.source}."
        )
    lines.append(
        "A tracked knee is a hinge, and so is an elbow: what they do beside flexing is that of the tilt of its axis."
    )
    return lines


def _uncertain(found: IsbAngles) -> str:
    if found.deviations is None:
        return "Confidence is the least of the joint's landmarks; standard deviations are not known."
    return (
        "Confidence is the least of the joint's landmarks; standard deviations are those the landmarks' covariances "
        "leave, first order, at most 180; none for an angle that the tracked joint does not turn by."
    )


def _numbers(values: np.ndarray) -> list[str]:
    return [f"{value:.4f}" if np.isfinite(value) else "" for value in values]
