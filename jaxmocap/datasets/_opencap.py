"""OpenCap's laboratory validation: Uhlrich, Falisse, Kidzinski, Muccini, Ko, Chaudhari, Hicks, Delp, OpenCap: Human
movement dynamics from smartphone videos, PLOS Computational Biology 19, 2023; five phones, ten people.

The layout is that of the authors' program (`labValidationVideosToKinematics.py` of opencap-core) and of its users:
`<subject>/VideoData/<session>/<camera>/cameraIntrinsicsExtrinsics.pickle` and beside it
`<trial>/<trial>_syncdWithMocap.avi`, or `InputMedia/<trial>/...` as their program arranges it. The pickle holds
`intrinsicMat`, `distortion` (as OpenCV's), and `rotation` and `translation` (millimetres) from a checkerboard on the
wall to the camera. Of its axes the one that is nearest to the pictures' way down, for the phones stand upright, is
turned to be down here. `imageSize` does not always fit the videos and is not read.

There is no truth. Markers (`MarkerData/Mocap/<trial>.trc`) are in the laboratory's world; what leads to the cameras'
is in `mocapToVideoTransform.yaml`, whose form is documented nowhere and whose rotation is, as its users found,
singular for every `Session1`. Videos begin up to six frames apart, by how much is not said. Not checked against the
data themselves.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from jaxmocap._results import InputError
from jaxmocap.capture import index_video

from ._array_pickle import read_array_pickle
from ._read_files import need, rotation_of, video_rate
from ._sequence import RecordedCamera, RecordedSequence, StaticCalibration

_VIDEO = "_syncdWithMocap.avi"
_SHAPES = {"intrinsicMat": 9, "distortion": 5, "rotation": 9, "translation": 3}
_UPRIGHT = 0.9  # cosine of the angle by which the pictures' way down may be off an axis
_NOTE = (
    "OpenCap's phones began up to six frames apart, and the data do not say by how much: run `jaxmocap sync` on the "
    "capture, and `jaxmocap refine-cameras` after tracking. There is no truth, for how the markers' world lies to that "
    "of the cameras is not documented."
)


class OpenCap:
    """A reader of trials of OpenCap's laboratory validation ("subject2/Session0/DJ1"), by default of three cameras."""

    name = "OpenCap's laboratory validation"
    licence = "as its page says; people are recognisable"
    download = "https://simtk.org/projects/opencap : LabValidation_withVideos, unpacked"
    cameras = ("Cam1", "Cam2", "Cam3")

    def sequences(self, folder: Path) -> list[str]:
        """List the trials in `folder`, which holds the subjects' folders."""
        found = set()
        for path in folder.glob(f"*/VideoData/*/Cam*/**/*{_VIDEO}"):
            subject, _, session, *_ = path.relative_to(folder).parts
            found.add(f"{subject}/{session}/{path.name.removesuffix(_VIDEO)}")
        return sorted(found)

    def read(self, folder: Path, sequence: str, cameras: tuple[str, ...] | None = None) -> RecordedSequence:
        """Read one trial. The world is turned to have y up; there is no truth."""
        subject, session, trial = sequence.split("/")
        base = folder / subject / "VideoData" / session
        found = tuple(self._camera(base / name, trial) for name in cameras or self.cameras)
        turn = _upright([camera.calibration.rotation for camera in found], base)
        turned = tuple(
            replace(one, calibration=replace(one.calibration, rotation=one.calibration.rotation @ turn))
            for one in found
        )
        rate = video_rate(found[0].pictures)
        return RecordedSequence(f"OpenCap-{subject}-{session}-{trial}", rate, "y", turned, note=_NOTE)

    def _camera(self, folder: Path, trial: str) -> RecordedCamera:
        videos = sorted(folder.rglob(f"{trial}{_VIDEO}"))
        video = videos[0] if videos else need(folder / trial / f"{trial}{_VIDEO}", f"the video of {folder.name}")
        calibration = _calibration(folder / "cameraIntrinsicsExtrinsics.pickle")
        centre, size = calibration.intrinsics[:2, 2], index_video(video).size
        if (centre[0] < centre[1]) != (size[0] < size[1]):
            raise InputError(
                f"{video} has pictures of {size[0]} x {size[1]}, but the camera's principal point is ({centre[0]:.0f}, "
                f"{centre[1]:.0f}): one of them lies on its side; a video as it was downloaded was expected."
            )
        return RecordedCamera(folder.name, video, calibration)


def _calibration(path: Path) -> StaticCalibration:
    need(path, "the calibration of the camera")
    arrays = read_array_pickle(path)
    for name, count in _SHAPES.items():
        array = arrays.get(name)
        if array is None or array.size != count or not np.isfinite(array).all():
            shown = "nothing" if array is None else f"an array of shape {array.shape}"
            raise InputError(f"{path} has {shown} as {name}; {count} finite numbers were expected.")
    intrinsics, rotation = (arrays[name].astype(float).reshape(3, 3) for name in ("intrinsicMat", "rotation"))
    return StaticCalibration(
        intrinsics,
        arrays["distortion"].astype(float).ravel(),
        rotation_of(rotation, intrinsics, path),
        1e-3 * arrays["translation"].astype(float).ravel(),
    )


def _upright(rotations: list[Float[np.ndarray, "3 3"]], base: Path) -> Float[np.ndarray, "3 3"]:
    """Find the turn from a world with y up to the checkerboard's, of whose axes one points up or down."""
    down = np.mean([rotation[1] for rotation in rotations], axis=0)
    axis = int(np.abs(down).argmax())
    if abs(down[axis]) < _UPRIGHT * np.linalg.norm(down):
        raise InputError(
            f"{base}: no axis of the checkerboard is vertical as the cameras see it (down is "
            f"{np.round(down, 2).tolist()}); calibrations of phones that stand upright were expected."
        )
    turn = np.zeros((3, 3))
    turn[axis, 1], turn[(axis + 1) % 3, 2] = -np.sign(down[axis]), 1.0
    turn[:, 0] = np.cross(turn[:, 1], turn[:, 2])
    return turn
