"""C3D: virtual markers for Mokka, Visual3D, MATLAB and the like."""

import errno
import os
import struct
from pathlib import Path

import numpy as np
from jaxtyping import Float

from jaxmocap._results import InputError
from jaxmocap.motion import Motion

from ._exporter import ExportForm

RESIDUAL_AT_ZERO = 0.1
"""Metres: the residual of a marker of no confidence, which falls to 0 as the confidence rises to 1, in motions that do
not know their uncertainty."""
_STEPS = 255
"""C3D stores a residual as a whole number of steps, at most 255."""
_BLOCK, _SCALE_AT, _DATA_AT = 512, 12, 16
"""Bytes: of a block of the file, and where its header has the scale and the number of the block of the first point."""
_LOST = "; -1 where a joint has no confidence or the person is lost"
_MOST_FRAMES = 65535
"""Their number has two bytes."""
_MOST_EVENTS = 255
"""The lengths of a C3D parameter are bytes."""
_INTEGER = 2
"""Bytes of a whole number, by which C3D says that a parameter is one."""
_EVENTS = {
    "Foot Strike": (1, "the first frame in which the heel or the toe stands"),
    "Foot Off": (2, "the last frame in which the heel or the toe stands"),
}
"""Number of the icon and description, by label."""


def write_c3d(motion: Motion, path: Path, form: ExportForm) -> None:
    """Write the joints and landmarks as virtual markers, and feet that begin or cease to stand as events.

    Where contacts were not looked for there is no group `EVENT`; where no foot begins or ceases to stand it is empty.

    The residual is the standard deviation of a place along one axis, the root of the mean over the three, where the
    motion knows its uncertainty. A frame that is lost, and a joint without any confidence, is marked as C3D marks what
    was not seen, by a residual of -1: most programs show a gap.
    """
    import ezc3d

    if len(motion) > _MOST_FRAMES:
        raise InputError(
            f"{form.name}: C3D holds {_MOST_FRAMES} frames, the motion has {len(motion)}; export parts, or a .trc."
        )
    confidence = np.where((motion.status == "lost")[:, None], 0.0, motion.confidence.astype(np.float64))
    deviations = motion.joint_deviations
    if deviations is None:
        step, metres = 0.0005, RESIDUAL_AT_ZERO * (1 - confidence)
        note = f"residual = {RESIDUAL_AT_ZERO:g} m * (1 - confidence)"
    else:
        step, metres = 0.002, deviations
        note = "residual = standard deviation of the place along one axis"
    scale = -form.per_metre * step  # negative: places are floating-point
    residuals = np.where(confidence > 0, np.minimum(np.floor(metres / step + 0.5), _STEPS), -1.0)
    file = ezc3d.c3d()
    point = file["parameters"]["POINT"]
    rate = form.frame_rate or 30.0
    point["RATE"]["value"] = [rate]
    point["UNITS"]["value"] = [form.units]
    point["SCALE"]["value"] = [scale]
    point["LABELS"]["value"] = list(motion.joint_names)
    point["DESCRIPTIONS"]["value"] = [f"virtual marker, {note}{_LOST}"] * len(motion.joint_names)
    file.add_parameter("POINT", "X_SCREEN", ["+X"])
    file.add_parameter("POINT", "Y_SCREEN", [f"+{form.up.upper()}"])
    file.add_parameter("JAXMOCAP", "RESIDUALS", [note + _LOST])
    file.add_parameter("JAXMOCAP", "START_SECONDS", [float(motion.timestamps[0])])
    places = np.ones((4, len(motion.joint_names), len(motion)))
    places[:3] = form.per_metre * motion.joints.astype(np.float64).transpose(2, 1, 0)
    file["data"]["points"] = places
    file["data"]["meta_points"]["residuals"] = np.minimum(residuals, 0.0).T[None]
    events = _foot_events(motion)
    if motion.contacts is not None and not events:
        file.add_parameter("EVENT", "USED", [0])
        file["parameters"]["EVENT"]["USED"]["type"] = _INTEGER
    if len(events) > _MOST_EVENTS:
        last = events[_MOST_EVENTS - 1][0] / rate
        form.say(f"{form.name}: C3D holds {_MOST_EVENTS} foot events; those after {last:.2f} s are left out.")
    for position, foot, label in events[:_MOST_EVENTS]:
        icon, description = _EVENTS[label]
        file.add_event(divmod(position / rate, 60), foot, label, description, icon_id=icon)
    written = path.with_name(f"{path.name}.c3d")  # ezc3d knows small letters alone
    try:
        file.write(str(written))
        path.write_bytes(_as_the_format_says(bytearray(written.read_bytes()), scale, residuals))
    finally:
        written.unlink(missing_ok=True)


def _as_the_format_says(content: bytearray, scale: float, residuals: Float[np.ndarray, "frame joint"]) -> bytearray:
    """Change what ezc3d writes in a way of its own: the scale in the header, and residuals in the points.

    The header holds the scale of the parameters once more, where ezc3d has -1 whatever it is, and py-c3d refuses files
    in which they differ. The fourth number of a point has the residual in its low byte, in steps of the scale, and the
    cameras in its high one; ezc3d has them the other way round, which others read as cameras or as not seen.

    ezc3d does not notice a full disk, for which this raises `OSError`. It enters the block of the first point last:
    until then that is the header's own, the first one.
    """
    block = int.from_bytes(content[_DATA_AT : _DATA_AT + 2], "little")
    if block < 2 or len(content) < _BLOCK * (block - 1) + 16 * residuals.size:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    struct.pack_into("<f", content, _SCALE_AT, scale)
    points = np.frombuffer(content, "<f4", 4 * residuals.size, _BLOCK * (block - 1))
    points.reshape(*residuals.shape, 4)[..., 3] = residuals
    return content


def _foot_events(motion: Motion) -> list[tuple[int, str, str]]:
    """List position, foot and label; a foot that stands as the motion begins, or ends, has no event there."""
    found = []
    if motion.foot_contact is None:
        return found
    steps = np.diff(motion.foot_contact.astype(np.int8), axis=0)
    for foot, changes in zip(("Left", "Right"), steps.T, strict=True):
        found += [(int(position) + 1, foot, "Foot Strike") for position in np.flatnonzero(changes > 0)]
        found += [(int(position), foot, "Foot Off") for position in np.flatnonzero(changes < 0)]
    return sorted(found, key=lambda event: event[0])
