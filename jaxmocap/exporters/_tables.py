"""CSV and Parquet: joint angles and joint positions as a table, one row per frame."""

import csv
import io
from pathlib import Path
from typing import Any

import numpy as np

from jaxmocap._files import write_text
from jaxmocap._results import InputError
from jaxmocap.motion import Motion, turned

from ._exporter import ExportForm
from ._prepare import euler_angles, neutral_angles


def write_csv(motion: Motion, path: Path, form: ExportForm) -> None:
    """Write comma-separated values; units are in the names of the columns."""
    table = columns(motion, form)
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(table)
    for row in zip(*table.values(), strict=True):
        writer.writerow([f"{value:.6f}" if isinstance(value, float) else value for value in row])
    write_text(path, text.getvalue())


def write_parquet(motion: Motion, path: Path, form: ExportForm) -> None:
    """Write the columns of the CSV, with units, vertical axis and frame rate in the metadata of the schema."""
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        raise InputError(
            f"{form.name} needs pyarrow, which is not installed; run pip install 'jaxmocap[parquet]', or write a .csv."
        ) from None
    rate = "varying" if form.frame_rate is None else f"{form.frame_rate:.9g}"
    note = {"units": form.units, "angles": "degrees", "up": form.up, "frame_rate": rate, "generator": "jaxmocap"}
    table = pyarrow.table(columns(motion, form)).replace_schema_metadata(note)
    pyarrow.parquet.write_table(table, path)


def columns(motion: Motion, form: ExportForm) -> dict[str, list[Any]]:
    """Make the table, by columns.

    These are `frame` (of the first camera's video, or counted from 0 if resampled), `seconds`, `status`; the pelvis'
    turn about the vertical axis (left), tilt forward and lean to its right, and the joint angles, in degrees from the
    neutral body; per joint its place and confidence; where contacts were looked for, whether each foot stands, 1 or 0.
    """
    table: dict[str, list[Any]] = {
        "frame": motion.frames.tolist(),
        "seconds": motion.timestamps.tolist(),
        "status": motion.status.tolist(),
    }
    pelvis = np.degrees(euler_angles(turned(motion, "y").root[:, :3, :3], "YXZ"))
    for name, values in zip(("turn", "tilt", "lean"), pelvis.T, strict=True):
        table[f"pelvis_{name}_deg"] = values.tolist()
    for name, values in zip(motion.character.skeleton.angle_names, np.degrees(neutral_angles(motion)).T, strict=True):
        table[f"{name}_deg"] = values.tolist()
    places = form.per_metre * motion.joints.astype(np.float64)
    for joint, name in enumerate(motion.joint_names):
        for axis, letter in enumerate("xyz"):
            table[f"{name}_{letter}_{form.units}"] = places[:, joint, axis].tolist()
        table[f"{name}_confidence"] = motion.confidence[:, joint].astype(np.float64).tolist()
    if (foot_contact := motion.foot_contact) is not None:
        for side, stands in zip("lr", foot_contact.T, strict=True):
            table[f"{side}_foot_contact"] = stands.astype(int).tolist()
    return table
