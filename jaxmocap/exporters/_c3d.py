"""C3D: virtual markers for Mokka, Visual3D, MATLAB and the like."""

from pathlib import Path

import numpy as np

from jaxmocap.motion import Motion

from ._exporter import ExportForm

RESIDUAL_AT_ZERO = 0.1
"""Metres: the residual of a marker of no confidence. It falls to 0 as the confidence rises to 1."""
_STEPS = 200
"""C3D stores a residual as a whole number of steps, at most 255."""
_NOTE = f"residual = {RESIDUAL_AT_ZERO:g} m * (1 - confidence); -1 where it is 0 or the person is lost"


def write_c3d(motion: Motion, path: Path, form: ExportForm) -> None:
    """The joints and landmarks as virtual markers. A frame that is lost, and a joint without any confidence, is marked
    as C3D marks what was not seen, by a residual of -1: most programs show a gap there."""
    import ezc3d

    file = ezc3d.c3d()
    point = file["parameters"]["POINT"]
    rate = form.frame_rate or 30.0
    point["RATE"]["value"] = [rate]
    point["UNITS"]["value"] = [form.units]
    point["SCALE"]["value"] = [-form.per_metre * RESIDUAL_AT_ZERO / _STEPS]  # negative: places are floating-point
    point["LABELS"]["value"] = list(motion.joint_names)
    point["DESCRIPTIONS"]["value"] = [f"virtual marker, {_NOTE}"] * len(motion.joint_names)
    file.add_parameter("POINT", "X_SCREEN", ["+X"])
    file.add_parameter("POINT", "Y_SCREEN", [f"+{form.up.upper()}"])
    file.add_parameter("JAXMOCAP", "RESIDUALS", [_NOTE])
    file.add_parameter("JAXMOCAP", "START_SECONDS", [float(motion.timestamps[0])])
    places = np.ones((4, len(motion.joint_names), len(motion)))
    places[:3] = form.per_metre * motion.joints.astype(np.float64).transpose(2, 1, 0)
    file["data"]["points"] = places
    confidence = np.where((motion.status == "lost")[:, None], 0.0, motion.confidence.astype(np.float64))
    residuals = np.where(confidence > 0, form.per_metre * RESIDUAL_AT_ZERO * (1 - confidence), -1.0)
    file["data"]["meta_points"]["residuals"] = residuals.T[None]
    file.write(str(path))
