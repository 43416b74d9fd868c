"""One evaluation of a result against the truth of its capture, and its table for the terminal."""

import os
from collections.abc import Mapping
from typing import Any, Literal

import numpy as np
from rich.table import Table

from jaxmocap._results import InputError
from jaxmocap.geometry import IDENTITY, Similarity, align_cameras, camera_residuals, fit_similarity
from jaxmocap.motion import Motion

from ._joints import JOINTS, Joints, joint_errors, joint_statistics
from ._markers import marker_error, marker_statistics
from ._motion_quality import foot_skate, jitter
from ._truth import Truth

Align = Literal["cameras", "joints"]

REGIONS = (0.5, 0.9, 0.99)
"""Shares of the truth that the regions of a motion's uncertainty should hold."""

_ROWS = (
    ("marker_error_cm", "Markers"),
    ("marker_error_offset_corrected_cm", "Markers, constant offsets removed"),
    ("marker_error_realigned_cm", "Markers, realigned once (not the paper's)"),
    ("joint_error_cm", "Joints"),
    ("joint_error_offset_corrected_cm", "Joints, constant offsets removed"),
)
_SINGLE = (("mpjpe_root_aligned_cm", "Joints, root-aligned"), ("pa_mpjpe_cm", "Joints, after Procrustes"))
_COLUMNS = ("mean", "min", "max", "p95")


def evaluate(
    result: Motion | str | os.PathLike[str],
    truth: str | os.PathLike[str],
    *,
    joints: Joints = "comparable",
    align: Align = "cameras",
) -> dict[str, Any]:
    """Score a result (a motion or its folder) against a truth file; see `Truth.read` for what that may hold.

    Frames are matched by time; those beyond the truth or in a hole of it are left out (`frames_without_truth`). Where
    the truth holds the cameras' true poses and the result its own, the result's world is first brought to the truth's
    once, by the similarity between the two sets of cameras; `aligned_by` says so. With `align="joints"` it is the
    similarity between the scored joints of all frames, for a result whose cameras were calibrated from its own videos
    and a truth that holds none: then place, direction and size say nothing.

    `joints` says which joints are scored. A joint of the same name is not always the same point: pelvis, spine, thorax
    and head lie elsewhere in every rig. So "comparable", the default, scores the neck, shoulders, elbows, wrists, hips,
    knees and ankles; "all" scores every joint of the skeleton; a list of names scores exactly these. Where the truth
    says that its joints are those of our skeleton (`joint_definitions`), all are comparable.

    Returns what is known of, in centimetres: `frames`, `lost_frames`, `frame_numbers` (those scored, of which
    `marker_error_per_frame_cm` holds one each), `marker_error_cm` {mean, min, max, p95}, `joint_error_cm` and
    `joint_error_offset_corrected_cm` {mean, p95, max}, `joints_scored` [name, ...], `joints_left_out` {name: mean
    error}, `pa_mpjpe_cm`, `seconds_per_frame`, `uncertainty_coverage` (how often the regions of 50, 90 and 99 % hold
    the true joint), and further keys. `min` and `max` of markers are over frames of the per-frame mean; `p95` and the
    joints' `max` are over single points. Raises `InputError` if the files cannot be read or do not belong together.
    """
    motion = result if isinstance(result, Motion) else Motion.load(result)
    reference, evaluated = Truth.read(truth).at(motion)
    scores: dict[str, Any] = {"frames": len(evaluated), "lost_frames": int((evaluated.status == "lost").sum())}
    scores["frame_numbers"] = evaluated.frames.tolist()
    if len(evaluated) < len(motion):
        scores["frames_without_truth"] = len(motion) - len(evaluated)
    if align == "joints":
        placed, alignment = _aligned_by_joints(reference, evaluated, joints)
    else:
        placed, alignment = _aligned_by_cameras(reference, evaluated)
    if reference.markers is not None:
        scores |= _marker_scores(evaluated, reference.markers, placed)
    if reference.joints is not None:
        scores |= _joint_scores(evaluated, reference, _comparable(reference, joints), placed)
    scores["jitter_m_per_s2"] = jitter(motion, placed.scale)  # all frames: those evaluated may not follow each other
    skate = foot_skate(motion).summary()
    if skate:
        scores["foot_skate_m_per_s"] = {name: placed.scale * speed for name, speed in skate.items()}
    seconds = motion.provenance.get("seconds_per_frame")
    if seconds is not None:
        scores["seconds_per_frame"] = float(seconds)
    return scores | alignment


def evaluation_table(scores: Mapping[str, Any], title: str = "Evaluation") -> Table:
    """Lay out what `evaluate` returned for `rich.print`: a row per error in centimetres, the rest in the caption."""
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


def _comparable(truth: Truth, joints: Joints) -> Joints:
    """All joints are comparable where the truth's are those of our skeleton."""
    return "all" if joints == "comparable" and truth.has_our_joints else joints


def _aligned_by_joints(truth: Truth, motion: Motion, joints: Joints) -> tuple[Similarity, dict[str, Any]]:
    """truth_from_world, and what to say about it."""
    if truth.joints is None:
        raise InputError(
            f"{truth.path} holds no joints to align by; align by the cameras, or give a truth with joints."
        )
    errors = joint_errors(motion, truth.joints, truth.joint_names, joints=_comparable(truth, joints))
    ours = motion.joints[:, [motion.joint_names.index(name) for name in errors.names]].astype(np.float64)
    true = np.asarray(truth.joints, np.float64)[:, [list(truth.joint_names).index(name) for name in errors.names]]
    known = np.isfinite(true).all(-1)
    similarity = fit_similarity(ours[known], true[known])
    return similarity, {
        "aligned_by": f"one similarity over {int(known.sum())} joints: place, direction and size are not scored",
        "alignment": {"scale": similarity.scale, "rotation_degrees": float(np.degrees(similarity.angle))},
    }


def _aligned_by_cameras(truth: Truth, motion: Motion) -> tuple[Similarity, dict[str, Any]]:
    """truth_from_world, and what to say about it."""
    if truth.cam_from_world is None:
        return IDENTITY, {}
    if motion.cameras is None:
        return IDENTITY, {"aligned_by": "nothing: the truth holds cameras, the result holds none"}
    pairs = truth.camera_pairs(motion)
    similarity = align_cameras(*pairs)
    distance, angle = camera_residuals(similarity, *pairs)
    return similarity, {
        "aligned_by": f"one similarity over {len(distance)} camera poses",
        "alignment": {
            "scale": similarity.scale,
            "rotation_degrees": float(np.degrees(similarity.angle)),
            "camera_centre_residual_cm": float(100 * np.sqrt(np.mean(distance**2))),
            "camera_angle_residual_degrees": float(np.degrees(np.sqrt(np.mean(angle**2)))),
        },
    }


def _marker_scores(motion: Motion, markers: np.ndarray, placed: Similarity) -> dict[str, Any]:
    errors = marker_error(motion.character, motion, markers, truth_from_world=placed)
    return {
        "marker_error_cm": marker_statistics(errors.distances),
        "marker_error_offset_corrected_cm": marker_statistics(errors.offset_corrected),
        "marker_error_realigned_cm": marker_statistics(errors.realigned),
        "marker_error_per_frame_cm": [float(100 * error) for error in errors.per_frame],
        "markers": int((errors.faces >= 0).sum()),
    }


def _joint_scores(motion: Motion, truth: Truth, joints: Joints, placed: Similarity) -> dict[str, Any]:
    assert truth.joints is not None
    errors = joint_errors(motion, truth.joints, truth.joint_names, joints=joints, truth_from_world=placed)
    scores: dict[str, Any] = {
        "joint_error_cm": joint_statistics(errors.raw),
        "joint_error_offset_corrected_cm": joint_statistics(errors.offset_corrected),
        "joint_error_by_name_cm": {name: 100 * error for name, error in errors.by_name().items()},
        "joints_scored": list(errors.names),
        "joints_left_out": {name: 100 * error for name, error in errors.left_out.items()},
        "pck_150mm": errors.correct_keypoints(),
    }
    if errors.deviations is not None:
        scores["uncertainty_coverage"] = {f"{100 * share:g}%": errors.coverage(share) for share in REGIONS}
    if errors.root_aligned is not None and np.isfinite(errors.root_aligned).any():
        scores["mpjpe_root_aligned_cm"] = float(100 * np.nanmean(errors.root_aligned))
    if np.isfinite(errors.procrustes).any():
        scores["pa_mpjpe_cm"] = float(100 * np.nanmean(errors.procrustes))
    if np.isfinite(errors.acceleration).any():
        scores["acceleration_error_m_per_s2"] = float(np.nanmean(errors.acceleration))
    return scores


def _caption(scores: Mapping[str, Any]) -> str:
    parts = [f"{scores['frames']} frames, {scores['lost_frames']} lost"]
    if "seconds_per_frame" in scores:
        parts.append(f"{scores['seconds_per_frame']:.2f} s per frame")
    if "frames_without_truth" in scores:
        parts.append(f"{scores['frames_without_truth']} more without truth")
    if "joints_scored" in scores:
        parts.append(f"joints scored: {', '.join(scores['joints_scored'])}")
    if left_out := _left_out(scores.get("joints_left_out", {})):
        parts.append(f"left out of the mean: {left_out}")
    if "uncertainty_coverage" in scores:
        held = ", ".join(f"{region}: {100 * share:.0f}%" for region, share in scores["uncertainty_coverage"].items())
        parts.append(f"true joints in their regions of {held}")
    if "aligned_by" in scores:
        parts.append(f"aligned by {scores['aligned_by']}")
    return "; ".join(parts)


def _left_out(errors: Mapping[str, float]) -> str:
    """Name the skeleton's joints with their errors in centimetres; count points on its surface and name the worst."""
    known = {name: error for name, error in errors.items() if np.isfinite(error)}
    surface = {name: error for name, error in known.items() if name not in JOINTS}
    worst = max(surface, key=lambda name: surface[name], default="")
    parts = [f"{name} {error:.2f} cm" for name, error in known.items() if name in JOINTS or len(surface) == 1]
    if len(surface) > 1:
        parts.append(f"{len(surface)} points on the surface, at worst {worst} {surface[worst]:.2f} cm (--json has all)")
    return ", ".join(parts)
