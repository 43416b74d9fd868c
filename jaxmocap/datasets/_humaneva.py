"""HumanEva I and II: Sigal, Balan, Black, IJCV 87, 2010. Layout as in the public loaders of its users.

`<subject>/Calibration_Data/<camera>.cal`: one number per line, fc (2), cc (2), alpha, kc (5), R (9, by rows), t (3,
millimetres), X_camera = R X + t. `<subject>/Sync_Data/<take>_(<camera>).ofs`: the image frame im_st that shows motion
capture frame mc_st, and mc_sc of these per image. `<subject>/Image_Data/<take>_(<camera>).avi`, or a folder of that
name with pictures. `<subject>/Mocap_Data/<take>.c3d`: markers, millimetres, z up.
"""

import re
from pathlib import Path

import numpy as np

from ._read_files import need, numbers_in, read_c3d, rotation_of
from ._sequence import RecordedCamera, RecordedSequence, StaticCalibration, sorted_pictures

_FPS, _MOCAP_FPS = 60.0, 120.0
_TAKE = re.compile(r"(.+)_\((\w+)\)(\.avi)?$")


class HumanEva:
    """A reader of takes of HumanEva I ("S1/Walking_1") or II ("S4/Combo_1").

    name: of the data set
    cameras: those used by default: the colour ones
    """

    licence = "free for research, after signing its agreement; not to be passed on"
    download = "http://humaneva.is.tue.mpg.de (an account is needed): the subject's whole folder"

    def __init__(self, name: str, cameras: tuple[str, ...]):
        self.name = name
        self.cameras = cameras

    def sequences(self, folder: Path) -> list[str]:
        """List the takes in `folder`, which holds the subjects' folders."""
        found = set()
        for pictures in folder.glob("*/Image_Data/*"):
            if take := _TAKE.match(pictures.name):
                found.add(f"{pictures.parent.parent.name}/{take[1]}")
        return sorted(found)

    def read(self, folder: Path, sequence: str, cameras: tuple[str, ...] | None = None) -> RecordedSequence:
        """Read one take. Time is that of the first camera; markers are those of its images."""
        subject, _, take = sequence.partition("/")
        base = folder / subject
        synchronised = [self._synchronisation(base, take, camera) for camera in cameras or self.cameras]
        first = self._begins(*synchronised[0])
        found = tuple(
            RecordedCamera(
                name,
                self._pictures(base, take, name),
                read_calibration(base / "Calibration_Data" / f"{name}.cal"),
                self._begins(*synchronised[index]) - first,
            )
            for index, name in enumerate(cameras or self.cameras)
        )
        markers, times = self._markers(base / "Mocap_Data" / f"{take}.c3d", first)
        name = f"{self.name}-{subject}-{take}"
        return RecordedSequence(name, _FPS, "z", found, markers, times)

    def _pictures(self, base: Path, take: str, camera: str) -> Path:
        video = base / "Image_Data" / f"{take}_({camera}).avi"
        folder = video.with_suffix("")
        if folder.is_dir() and sorted_pictures(folder):
            return folder
        return need(video, f"the video of camera {camera}, or a folder {folder.name} with its pictures,")

    def _synchronisation(self, base: Path, take: str, camera: str) -> np.ndarray:
        return numbers_in(base / "Sync_Data" / f"{take}_({camera}).ofs", 3)[:3]

    @staticmethod
    def _begins(image_frame: float, mocap_frame: float, per_image: float) -> float:
        """Tell the seconds of the motion capture's clock at a camera's first image; frames count from 1."""
        return (mocap_frame - 1 - (image_frame - 1) * per_image) / _MOCAP_FPS

    def _markers(self, path: Path, first: float) -> tuple[np.ndarray | None, np.ndarray | None]:
        if not path.is_file():
            return None, None  # withheld for some takes
        _, markers, rate = read_c3d(path)
        times = np.arange(len(markers)) / rate - first
        shown = times >= -0.5 / _FPS
        return markers[shown], times[shown]


def read_calibration(path: Path) -> StaticCalibration:
    """Read a `.cal` file, lengths in metres. Raises `InputError` where the numbers cannot be a camera."""
    values = numbers_in(path, 22)
    (fx, fy), (cx, cy), skew, kc = values[0:2], values[2:4], values[4], values[5:10]
    rotation = values[10:19].reshape(3, 3)
    intrinsics = np.array([[fx, skew * fx, cx], [0, fy, cy], [0, 0, 1.0]])
    return StaticCalibration(intrinsics, kc, rotation_of(rotation, intrinsics, path), 1e-3 * values[19:22])


HUMANEVA_1 = HumanEva("HumanEva-I", ("C1", "C2", "C3"))
HUMANEVA_2 = HumanEva("HumanEva-II", ("C1", "C2", "C3"))
"""The paper uses three of HumanEva II's four colour cameras."""
