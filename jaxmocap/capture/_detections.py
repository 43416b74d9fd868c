"""A detector's keypoints at many frames of a capture, beside those of the selected frames."""

from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from jaxmocap._results import InputError

from ._capture import Capture


@dataclass(frozen=True)
class Detections:
    """A detector's keypoints; a frame or camera may be missing.

    Attributes:
        capture: the capture they are of.
        folder: files of the forms and names that the capture's keypoints may have (`jaxmocap.detection`).
        frames: positions at which they may be used; None: all.
    """

    capture: Capture
    folder: Path
    frames: Collection[int] | None = None

    @staticmethod
    def open(capture: Capture, folder: str | Path, frames: Collection[int] | None = None) -> "Detections":
        """Open a folder.

        Raises `InputError` when it does not exist or has no file of this capture in the frames asked for.
        """
        folder = Path(folder)
        if not folder.is_dir():
            raise InputError(
                f"detections {folder}: there is no such folder; give one with OpenPose or other keypoints."
            )
        detections = Detections(capture, folder, frames)
        if not any(detections.has(c, f) for f in range(capture.num_frames) for c in range(capture.num_cameras)):
            name = f"{capture.camera_names[0]}_{capture.video_frames[0, 0]:05d}_keypoints.json"
            raise InputError(
                f"detections {folder} hold no file of capture '{capture.name}' in the frames asked for; files are "
                f"named {name} and so on."
            )
        return detections

    def has(self, camera_index: int, frame: int) -> bool:
        """Tell whether there are keypoints on file that may be used."""
        wanted = self.frames is None or frame in self.frames
        source = self.capture.video_keypoints(camera_index, self.folder)
        return wanted and source is not None and source.has(int(self.capture.video_frames[camera_index, frame]))

    def people(self, camera_index: int, frame: int) -> list[Float64[np.ndarray, "25 3"]]:
        """Read everybody found in one view; empty where there is no file that may be used.

        Raises `InputError` for a file that cannot be read.
        """
        return self.capture.people(camera_index, frame, self.folder) if self.has(camera_index, frame) else []
