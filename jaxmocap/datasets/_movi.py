"""MoVi: Ghorbani, Mahdaviani, Thaler, Kording, Cook, Blohm, Troje, MoVi: a large multi-purpose human motion and video
dataset, PLOS ONE 16, 2021; two fixed views (PG1, PG2) of round F, with 67 markers.

File names are those of table 3 of the paper: `F_<camera>_Subject_<ID>_L.avi`, `cameraParams_<camera>.npz`,
`Extrinsics_<camera>.npz`, `F_v3d_Subject_<ID>.mat`; they may lie anywhere in the folder. What is in them is read as the
authors' MoVi-Toolbox does: MATLAB's cameras (a row times `rotationMatrix` plus `translationVector`, millimetres, then
times `IntrinsicMatrix`; the first pixel's centre at (1, 1)), `markerLocation` at 120 frames per second, and the motions
of a video in `motions_list`, from frame to frame in `flags30` (video) and `flags120` (markers), counted from 1; z is
up. The handheld views CP1 and CP2 have no calibration and are not read. Not checked against the data themselves.
"""

import re
from pathlib import Path
from typing import Any

import numpy as np

from jaxmocap._results import InputError

from ._read_files import rotation_of
from ._sequence import RecordedCamera, RecordedSequence, StaticCalibration

_FPS, _MOCAP_FPS = 30.0, 120.0
_VIDEO = re.compile(r"F_(PG\d)_Subject_(\d+)(_L)?\.avi$")


class MoVi:
    """A reader of the motions of MoVi's round F ("Subject_1/walking"), by default from both fixed cameras."""

    name = "MoVi"
    licence = "free for research that is not commercial, on the terms of its page; the AMASS part on those of AMASS"
    download = "https://www.biomotionlab.ca/movi : F_PG1 and F_PG2 videos, camera parameters and F_Subjects (V3D)"
    cameras = ("PG1", "PG2")

    def sequences(self, folder: Path) -> list[str]:
        """List the motions of all subjects in `folder` that have a video and a recording."""
        subjects = {match[2] for path in folder.rglob("*.avi") if (match := _VIDEO.match(path.name))}
        found = []
        for subject in sorted(subjects, key=int):
            recordings = sorted(folder.rglob(f"F_v3d_Subject_{subject}.mat"))
            if not recordings:
                continue
            path = recordings[0]
            found += [f"Subject_{subject}/{motion}" for motion in _motions(_move(path), path)]
        if subjects and not found:
            raise InputError(f"{folder} holds no F_v3d_Subject_{min(subjects, key=int)}.mat.")
        return found

    def read(self, folder: Path, sequence: str, cameras: tuple[str, ...] | None = None) -> RecordedSequence:
        """Read one motion: its part of the videos, and the markers from its own first frame on."""
        subject, _, motion = sequence.partition("/")
        number = subject.removeprefix("Subject_")
        path = _file(folder, f"F_v3d_{subject}.mat")
        move = _move(path)
        index = _motions(move, path).index(motion)
        video, mocap = (np.atleast_2d(np.asarray(move[name], int))[index] for name in ("flags30", "flags120"))
        markers = np.asarray(move["markerLocation"], float)
        if markers.ndim != 3 or markers.shape[2] != 3 or not 1 <= mocap[0] <= mocap[1] <= len(markers):
            raise InputError(f"{path}: markers of shape {markers.shape} do not hold the frames of {motion}.")
        markers = markers[mocap[0] - 1 : mocap[1]]
        seen = np.isfinite(markers).all(-1) & (markers != 0).any(-1)
        found = tuple(
            RecordedCamera(name, _video(folder, name, number), _calibration(folder, name))
            for name in cameras or self.cameras
        )
        return RecordedSequence(
            f"MoVi-{subject}-{re.sub(r'[^0-9A-Za-z]+', '-', motion).strip('-')}",
            _FPS,
            "z",
            found,
            np.where(seen[..., None], 1e-3 * markers, np.nan),
            np.arange(len(markers)) / _MOCAP_FPS,
            span=(int(video[0]) - 1, int(video[1])),
        )


def _file(folder: Path, name: str) -> Path:
    found = sorted(folder.rglob(name))
    if not found:
        raise InputError(f"{folder} holds no {name}.")
    return found[0]


def _video(folder: Path, camera: str, subject: str) -> Path:
    found = sorted(folder.rglob(f"F_{camera}_Subject_{subject}*.avi"))
    for path in found:
        match = _VIDEO.match(path.name)
        if match and match[2] == subject:
            return path
    raise InputError(f"{folder} holds no video F_{camera}_Subject_{subject}_L.avi.")


def _move(path: Path) -> dict[str, Any]:
    """Read the untrimmed recording of a Visual3D file."""
    from scipy.io import loadmat

    try:
        content = loadmat(path, simplify_cells=True)
    except (ValueError, NotImplementedError, OSError, TypeError, IndexError) as error:
        raise InputError(f"{path} is no MATLAB file that can be read ({error}).") from None
    subjects = [value for key, value in content.items() if key.startswith("Subject") and isinstance(value, dict)]
    move = subjects[0].get("move") if subjects else None
    if isinstance(move, list | np.ndarray) and len(move):
        move = move[0]
    missing = {"markerLocation", "flags30", "flags120", "motions_list"} - set(move or ())
    if not isinstance(move, dict) or missing:
        raise InputError(f"{path} holds no recording of round F; {', '.join(sorted(missing))} is not there.")
    return move


def _motions(move: dict[str, Any], path: Path) -> list[str]:
    """List the motions, numbered where a name comes twice."""
    names = [str(name) for name in np.atleast_1d(move["motions_list"])]
    flags = [np.atleast_2d(move[name]).shape for name in ("flags30", "flags120")]
    if set(flags) != {(len(names), 2)}:
        raise InputError(f"{path} names {len(names)} motions, and flags of shapes {flags[0]} and {flags[1]}.")
    return [f"{name}_{names[:k].count(name) + 1}" if name in names[:k] else name for k, name in enumerate(names)]


def _calibration(folder: Path, camera: str) -> StaticCalibration:
    inside, outside = (_file(folder, f"{kind}_{camera}.npz") for kind in ("cameraParams", "Extrinsics"))
    try:
        with np.load(inside, allow_pickle=False) as lens, np.load(outside, allow_pickle=False) as pose:
            matrix = np.asarray(lens["IntrinsicMatrix"], float).T
            radial, tangential = (
                np.ravel(lens[f"{kind}Distortion"]).astype(float) for kind in ("Radial", "Tangential")
            )
            rotation, translation = np.asarray(pose["rotationMatrix"], float).T, np.ravel(pose["translationVector"])
    except (KeyError, ValueError, OSError) as error:
        raise InputError(f"{inside} and {outside.name} hold no camera ({error}).") from None
    matrix[:2, 2] -= 1.0  # MATLAB counts from 1
    radial = np.pad(radial, (0, max(3 - len(radial), 0)))
    distortion = np.array([radial[0], radial[1], *tangential[:2], radial[2]])
    return StaticCalibration(
        matrix, distortion, rotation_of(rotation, matrix, outside), 1e-3 * translation.astype(float)
    )
