"""TNT15: von Marcard, Pons-Moll, Rosenhahn, Human pose estimation from video and IMUs, PAMI 38, 2016 (the paper's
"TNT16"). There is no optical truth; the reader gives pictures, cameras and the subject's mesh.

The layout that is read, one folder per recording: `Images/<camera>/` with a picture per frame (or
`Images/<camera>.avi`), `Calibration/<camera>.txt` with 21 numbers, K (9, by rows) and [R | t] (12, by rows, millimetres
from the world to the camera), and optionally `Mesh/*.obj`. Where a copy of the data is arranged otherwise, rename to
this.
"""

from pathlib import Path

import numpy as np

from jaxmocap._results import InputError

from ._read_files import need, numbers_in
from ._sequence import RecordedCamera, RecordedSequence, StaticCalibration

_FPS = 50.0


class TNT15:
    """A reader of recordings of TNT15, by default of cameras 0, 2 and 4, which the paper uses."""

    name = "TNT15"
    licence = "free for research, with citation; see its page"
    download = "https://www.tnt.uni-hannover.de/project/TNT15/ : pictures, calibration and meshes"
    cameras = ("0", "2", "4")

    def sequences(self, folder: Path) -> list[str]:
        """List the recordings in `folder`."""
        return sorted(path.parent.name for path in folder.glob("*/Images"))

    def read(self, folder: Path, sequence: str, cameras: tuple[str, ...] | None = None) -> RecordedSequence:
        """Read one recording."""
        base = folder / sequence
        found = tuple(
            RecordedCamera(
                f"cam{name}", self._pictures(base, name), self._calibration(base / "Calibration" / f"{name}.txt")
            )
            for name in cameras or self.cameras
        )
        meshes = sorted((base / "Mesh").glob("*.obj"))
        return RecordedSequence(f"TNT15-{sequence}", _FPS, "z", found, actor=meshes[0] if meshes else None)

    @staticmethod
    def _pictures(base: Path, camera: str) -> Path:
        folder = base / "Images" / camera
        return (
            folder if folder.is_dir() else need(base / "Images" / f"{camera}.avi", f"the pictures of camera {camera}")
        )

    @staticmethod
    def _calibration(path: Path) -> StaticCalibration:
        values = numbers_in(path, 21)
        intrinsics, pose = values[:9].reshape(3, 3), values[9:21].reshape(3, 4)
        rotation = pose[:, :3]
        if intrinsics[0, 0] <= 0 or np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-2:
            raise InputError(f"{path} holds no camera: its focal length or its rotation cannot be true.")
        left, _, right = np.linalg.svd(rotation)
        return StaticCalibration(intrinsics / intrinsics[2, 2], np.zeros(5), left @ right, 1e-3 * pose[:, 3])
