"""An evaluation as a table for the terminal."""

from collections.abc import Mapping
from typing import Any

from rich.table import Table

_ROWS = (
    ("marker_error_cm", "Markers"),
    ("marker_error_offset_corrected_cm", "Markers, constant offsets removed"),
    ("marker_error_realigned_cm", "Markers, realigned once (not the paper's)"),
    ("joint_error_cm", "Joints"),
    ("joint_error_offset_corrected_cm", "Joints, constant offsets removed"),
)
_SINGLE = (("mpjpe_root_aligned_cm", "Joints, root-aligned"), ("pa_mpjpe_cm", "Joints, after Procrustes"))
_COLUMNS = ("mean", "min", "max", "p95")


def evaluation_table(scores: Mapping[str, Any], title: str = "Evaluation") -> Table:
    """What `evaluate` returned, for `rich.print`: one row per error in centimetres, the frames in the caption."""
    table = Table(title=title, caption=_caption(scores), caption_justify="left")
    table.add_column("Error in cm")
    for column in _COLUMNS:
        table.add_column(column, justify="right")
    for key, label in _ROWS:
        if key in scores:
            values = scores[key]
            table.add_row(label, *(f"{values[column]:.2f}" if column in values else "" for column in _COLUMNS))
    for key, label in _SINGLE:
        if key in scores:
            table.add_row(label, f"{scores[key]:.2f}", "", "", "")
    return table


def _caption(scores: Mapping[str, Any]) -> str:
    parts = [f"{scores['frames']} frames, {scores['lost_frames']} lost"]
    if "seconds_per_frame" in scores:
        parts.append(f"{scores['seconds_per_frame']:.2f} s per frame")
    if "frames_without_truth" in scores:
        parts.append(f"{scores['frames_without_truth']} more without truth")
    if "joints_scored" in scores:
        parts.append(f"joints scored: {', '.join(scores['joints_scored'])}")
    if scores.get("joints_left_out"):
        left_out = ", ".join(f"{name} {error:.2f} cm" for name, error in scores["joints_left_out"].items())
        parts.append(f"left out of the mean: {left_out}")
    if "uncertainty_coverage" in scores:
        held = ", ".join(f"{region}: {100 * share:.0f}%" for region, share in scores["uncertainty_coverage"].items())
        parts.append(f"true joints in their regions of {held}")
    if "aligned_by" in scores:
        parts.append(f"aligned by {scores['aligned_by']}")
    return "; ".join(parts)
