"""What the report page plots and lists of a result: curves and tables, as JSON holds them."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from jaxmocap.camera import ranges
from jaxmocap.character import angles_at_rest
from jaxmocap.metrics import JOINTS, accelerations, foot_skate, jitter
from jaxmocap.motion import Motion

from ._report_findings import frame_verdicts, frames_said, selected_fits

_AT_LIMIT = np.radians(1.0)


def report_record(motion: Motion, report: Mapping[str, Any]) -> dict[str, Any]:
    """Collect everything the page plots and lists; `report` is what `report.json` holds."""
    inner = np.linalg.norm(accelerations(motion.joints.astype(np.float64), motion.timestamps), axis=-1).mean(axis=1)
    skate = foot_skate(motion)
    names = _reported_joints(motion)
    joints = [motion.joint_names.index(name) for name in names]
    return {
        "frames": motion.frames.tolist(),
        "seconds": _rounded(motion.timestamps, 3),
        "status": frame_verdicts(motion),
        "energy": {name: _rounded(values, 4) for name, values in motion.energy.items()},
        "confidence": {
            "names": names,
            "values": [_rounded(motion.confidence[:, joint], 2) for joint in joints],
            "mean": _rounded(motion.confidence.mean(axis=1), 3),
        },
        "uncertainty": _uncertainty(motion),
        "angles": _angles(motion),
        "jitter": {
            "values": _rounded(np.concatenate([[np.nan], inner, [np.nan]])[: len(motion)], 2),
            "summary": jitter(motion),
        },
        "skate": {
            "left": _rounded(np.append(skate.speed[:, 0], np.nan), 3),
            "right": _rounded(np.append(skate.speed[:, 1], np.nan), 3),
            "contact": _foot_contact(motion),
            "summary": skate.summary(),
        },
        "timings": _timings(motion, report),
        "tables": _tables(motion),
    }


def read_report(path: Path) -> dict[str, Any]:
    """Read `report.json`; an empty record where there is none that can be read: the page stands on `motion.npz`."""
    try:
        report = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return report if isinstance(report, dict) else {}


def _reported_joints(motion: Motion) -> list[str]:
    """Name the joints whose curves are shown: those that every rig has, all landmarks of a skeleton without them."""
    return [name for name in JOINTS if name in motion.joint_names] or list(motion.joint_names)


def _uncertainty(motion: Motion) -> dict[str, Any] | None:
    """List standard deviations in centimetres: median over the joints, and each wrist and ankle, which err most."""
    deviations = motion.joint_deviations
    if deviations is None:
        return None
    names = [f"{side}_{end}" for end in ("wrist", "ankle") for side in "lr"]
    curves = {name: 100 * deviations[:, motion.joint_names.index(name)] for name in names if name in motion.joint_names}
    joints = [motion.joint_names.index(joint) for joint in _reported_joints(motion)]
    median = 100 * np.median(deviations[:, joints], axis=1)
    return {name: _rounded(values, 2) for name, values in {"median over joints": median, **curves}.items()}


def _foot_contact(motion: Motion) -> dict[str, list[int]] | None:
    """Tell of every frame whether a foot stands, 1 or 0; None where contacts were not looked for."""
    if (stands := motion.foot_contact) is None:
        return None
    return dict(zip(("left", "right"), stands.T.astype(int).tolist(), strict=True))


def _angles(motion: Motion) -> list[dict[str, Any]]:
    """Joint angles and limits in degrees from the neutral body, as in tables and OpenSim files."""
    skeleton = motion.character.skeleton
    rest = angles_at_rest(skeleton)
    lower, upper = np.asarray(skeleton.lower), np.asarray(skeleton.upper)
    at_limit = (motion.angles < lower + _AT_LIMIT) | (motion.angles > upper - _AT_LIMIT)
    return [
        {
            "name": name,
            "values": _rounded(np.degrees(motion.angles[:, dof] + rest[dof]), 1),
            "lower": round(float(np.degrees(lower[dof] + rest[dof])), 1),
            "upper": round(float(np.degrees(upper[dof] + rest[dof])), 1),
            "at_limit": int(at_limit[:, dof].sum()),
        }
        for dof, name in enumerate(skeleton.angle_names)
    ]


def _timings(motion: Motion, report: Mapping[str, Any]) -> dict[str, Any]:
    """Seconds by stage over all frames, the longest first, and seconds of each frame."""
    total: dict[str, float] = {}
    by_frame = {}
    for verdict in report.get("verdicts") or []:
        seconds = verdict.get("seconds") or {}
        by_frame[verdict.get("frame")] = sum(seconds.values())
        for stage, value in seconds.items():
            total[stage] = total.get(stage, 0.0) + value
    frames = range(len(motion)) if len(by_frame) == len(motion) else ()
    return {
        "stages": [[stage, round(value, 2)] for stage, value in sorted(total.items(), key=lambda item: -item[1])],
        "frames": _rounded(np.array([list(by_frame.values())[index] for index in frames]), 2),
        "whole": {name: round(value, 1) for name, value in (motion.provenance.get("seconds") or {}).items()},
    }


def _tables(motion: Motion) -> list[dict[str, Any]]:
    told = motion.provenance
    run: list[tuple[str, Any]] = [("frames", f"{len(motion)}, {frames_said(motion.frames.tolist())}")]
    run += [("character", motion.character.name), ("vertical axis", motion.up)]
    names = {"capture_name": "capture", "quality": "quality", "seed": "seed", "device": "device"}
    run += [(label, told[name]) for name, label in names.items() if told.get(name) is not None]
    run += [("file", Path(told["clip"]).name)] if told.get("clip") else []
    run += [("actor", Path(told["actor"]).name)] if told.get("actor") else []
    if told.get("detections"):
        run.append(("detections", Path(told["detections"]).name))
    if selected := told.get("selected_frames"):
        run.append(("selected frames", f"{ranges(selected['frames'])} ({selected['source']})"))
    if told.get("seconds_per_frame") is not None:
        run.append(("seconds per frame", f"{told['seconds_per_frame']:.2f}"))
    fits = []
    for frame, fit in selected_fits(motion):
        overlaps = ", ".join("unknown" if value is None else f"{value:.3f}" for value in fit["iou"])
        rms = fit.get("keypoint_rms_m")
        points = "" if rms is None else f"; keypoints off by {100 * rms:.1f} cm"
        masks = ", ".join(sorted({mask["source"] for mask in fit["masks"].values()}))
        fits.append((f"frame {frame}", f"overlap with the masks {overlaps}{points}; masks {masks}"))
    tables = [("This run", run), ("Selected frames", fits)]
    tables += [("Settings changed", list((told.get("settings") or {}).items()))]
    tables += [("Versions", list((told.get("versions") or {}).items()))]
    return [{"title": title, "rows": [[str(a), str(b)] for a, b in rows]} for title, rows in tables if rows]


def _rounded(values: np.ndarray, digits: int) -> list[float | None]:
    return [round(float(value), digits) if np.isfinite(value) else None for value in values]
