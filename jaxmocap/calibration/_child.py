"""Running the worker, so that a crash of native code ends a child process and not the program; and what it found."""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from jaxmocap._results import InputError
from jaxmocap.capture import Capture

from ._footage import Report


def run_worker(task: str, folder: Path, report: Report) -> None:
    """Run `_worker` on a task in a fresh interpreter and pass its progress on.

    No fork and no `multiprocessing`, so that the caller's script need not guard its main part. Raises `InputError` with
    the worker's sentence for unusable footage and for a crash of the native code, `RuntimeError` with the worker's
    traceback for a bug.
    """
    package = str(Path(__file__).parents[2])
    path = os.pathsep.join([package, *filter(None, [os.environ.get("PYTHONPATH")])])
    environment = os.environ | {"PYTHONPATH": path, "JAX_PLATFORMS": "cpu"}
    arguments = [sys.executable, "-m", "jaxmocap.calibration._worker", task, str(folder)]
    errors = folder / f"{task}.log"
    sentence = None
    with errors.open("wb") as log:
        child = subprocess.Popen(arguments, stdout=subprocess.PIPE, stderr=log, env=environment, text=True)
        try:
            assert child.stdout is not None
            for line in child.stdout:
                message = _message(line)
                if "progress" in message:
                    report(*message["progress"])
                sentence = message.get("error", sentence)
            code = child.wait()
        finally:
            if child.poll() is None:
                child.kill()
                child.wait()
    if code == 0:
        return
    if sentence is not None:
        raise InputError(sentence)
    tail = "\n".join(errors.read_text(encoding="utf-8", errors="replace").splitlines()[-30:])
    if code == 1:
        raise RuntimeError(f"the calibration failed:\n{tail}")
    raise InputError(
        f"structure from motion ended by {_ending(code)} and left no cameras; nothing was changed. Try again with "
        "another --seed or --key-step, or with more memory free."
    )


def _message(line: str) -> dict:
    """Read a line of the worker as JSON; other output is ignored."""
    try:
        message = json.loads(line)
    except ValueError:
        return {}
    return message if isinstance(message, dict) else {}


def _ending(code: int) -> str:
    """Say how a process ended."""
    if code < 0:
        name = signal.Signals(-code).name if -code in {s.value for s in signal.Signals} else f"signal {-code}"
        return f"a crash ({name})"
    return f"exit code {code}"


@dataclass(frozen=True)
class Solved:
    """The worker's result in the model's units and axes.

    Attributes:
        sizes: of the cameras' pictures, pixels.
        video_frames: the frame of its own video by camera and shared frame.
        places: camera and frame of its own video; other arrays by place are in this order.
        poses: cam_from_world by place.
        intrinsics: of each camera, pixels.
        distortion: of each camera, OpenCV's k1 k2 p1 p2 k3.
        points: of the background.
        distance: to the scene.
        tables: the other arrays of `result.npz`, by name.
    """

    sizes: tuple[tuple[int, int], ...]
    video_frames: Int[np.ndarray, "camera frame"]
    places: Int[np.ndarray, "place 2"]
    poses: Float[np.ndarray, "place 4 4"]
    intrinsics: Float[np.ndarray, "camera 3 3"]
    distortion: Float[np.ndarray, "camera 5"]
    points: Float[np.ndarray, "point 3"]
    distance: float
    tables: Mapping[str, np.ndarray]

    @staticmethod
    def read(file: Path, capture: Capture) -> "Solved":
        """Read `result.npz` of a capture as recorded."""
        with np.load(file, allow_pickle=False) as arrays:
            tables = dict(arrays)
        return Solved(
            sizes=capture.sizes,
            video_frames=capture.video_frames,
            places=tables.pop("places"),
            poses=tables.pop("cam_from_world"),
            intrinsics=tables.pop("intrinsics"),
            distortion=tables.pop("distortion"),
            points=tables.pop("points"),
            distance=float(tables.pop("distance")),
            tables=tables,
        )

    def index(self, camera: int, frame: int) -> int:
        """Find the row of a camera's pose at a shared frame (position)."""
        own = self.video_frames[camera, frame]
        return int(np.flatnonzero((self.places[:, 0] == camera) & (self.places[:, 1] == own))[0])

    def pose(self, camera: int, frame: int) -> Float[np.ndarray, "4 4"]:
        return self.poses[self.index(camera, frame)]

    def shared_poses(self) -> Float[np.ndarray, "camera frame 4 4"]:
        cameras, frames = self.video_frames.shape
        return np.stack([[self.pose(camera, frame) for frame in range(frames)] for camera in range(cameras)])
