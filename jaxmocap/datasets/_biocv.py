"""BioCV: Evans, Needham, Wade, Parsons, Colyer, McGuigan, Bilzon, Cosker, BioCV Motion Capture Dataset, University of
Bath, 2024: nine synchronised views, markers, force plates, photogrammetry scans.

Documented in the data set's own note (researchdata.bath.ac.uk/1258): per participant camera calibration files and a
folder per trial with nine videos, `markers.c3d` (processed in Visual3D), `raw.c3d` (unprocessed) and `led.c3d`. A
calibration file is text: width, height, K (9, by rows), L (16, by rows; world to camera) and k0 to k4 as OpenCV has
them, as its authors' program reads it (`calibration.cpp`). Programs of its users say the rest: files are called
`00.mp4` and `00.mp4*.calib`, those with `mocAligned` in their name being in the world of the markers, millimetres, z
up; a frame of `markers.c3d` belongs to a frame of the videos; and among its points are joint centres such as
LEFT_KNEE. Not checked against the data themselves.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from jaxmocap._results import InputError

from ._read_files import need, numbers_in, read_c3d, rotation_of, video_rate
from ._sequence import RecordedCamera, RecordedSequence, StaticCalibration

_SAME_RATE = 0.01  # of a rate: videos and markers that differ by less were triggered together
_JOINTS = {
    f"{side}_{joint}": f"{side[0].lower()}_{name}"
    for side in ("LEFT", "RIGHT")
    for joint, name in {
        "SHO": "shoulder",
        "ELBOW": "elbow",
        "WRIST": "wrist",
        "HIP": "hip",
        "KNEE": "knee",
        "ANKLE": "ankle",
    }.items()
}


class BioCV:
    """A reader of trials of BioCV ("P03/P03_WALK_01"), by default of all cameras."""

    name = "BioCV"
    licence = "as its page says; people are recognisable, and what you make public of them is your responsibility"
    download = "https://researchdata.bath.ac.uk/1258 : a participant's archive, unpacked"

    def sequences(self, folder: Path) -> list[str]:
        """List the trials in `folder`, which holds the participants' folders."""
        return sorted({f"{path.parent.parent.name}/{path.parent.name}" for path in folder.glob("*/*/00.mp4")})

    def read(self, folder: Path, sequence: str, cameras: tuple[str, ...] | None = None) -> RecordedSequence:
        """Read one trial. Truth is joint centres, and as markers those points that the unprocessed file has too."""
        participant, _, trial = sequence.partition("/")
        base = folder / participant / trial
        wanted = cameras or tuple(sorted(path.stem for path in base.glob("[0-9][0-9].mp4")))
        found = tuple(
            RecordedCamera(
                f"cam{name}",
                need(base / f"{name}.mp4", f"the video of camera {name}"),
                _calibration(folder / participant, base, name),
            )
            for name in wanted
        )
        fps = video_rate(found[0].pictures)
        result = RecordedSequence(f"BioCV-{trial}", fps, "z", found)
        path = base / "markers.c3d"
        return _with_truth(result, path, fps) if path.is_file() else result


def _with_truth(sequence: RecordedSequence, path: Path, fps: float) -> RecordedSequence:
    labels, points, rate = read_c3d(path)
    centres = [number for number, label in enumerate(labels) if label in _JOINTS]
    raw = path.with_name("raw.c3d")
    physical = set(read_c3d(raw)[0]) - set(_JOINTS) if raw.is_file() else set()
    skin = [number for number, label in enumerate(labels) if label in physical]
    if not centres and not skin:
        return sequence
    together = abs(rate - fps) < _SAME_RATE * fps
    times = np.arange(len(points)) / (fps if together else rate)
    return replace(
        sequence,
        times=times,
        markers=points[:, skin] if skin else None,
        joints=points[:, centres] if centres else None,
        joint_names=tuple(_JOINTS[labels[number]] for number in centres),
    )


def _calibration(participant: Path, trial: Path, camera: str) -> StaticCalibration:
    """Read the camera's file that is in the world of the markers: the trial's own before the participant's."""
    found = sorted(participant.rglob(f"{camera}.mp4*.calib"), key=lambda path: (path.parent == trial, path.name))
    aligned = [path for path in found if "mocAligned" in path.name]
    if not found:
        raise InputError(f"{participant} holds no calibration {camera}.mp4*.calib of camera {camera}.")
    path = (aligned or found)[-1]
    values = numbers_in(path, 32)[2:]
    intrinsics, pose = values[:9].reshape(3, 3), values[9:25].reshape(4, 4)
    scale = np.cbrt(np.linalg.det(pose[:3, :3])) or 1.0  # files in the markers' world hold a similarity, near 1
    return StaticCalibration(
        intrinsics / intrinsics[2, 2],
        values[25:30],
        rotation_of(pose[:3, :3] / scale, intrinsics, path),
        1e-3 * pose[:3, 3] / scale,
    )
