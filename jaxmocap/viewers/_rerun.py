"""A result as a recording for the Rerun viewer."""

import os
from importlib import import_module
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from jaxmocap._files import atomic_path
from jaxmocap._results import InputError
from jaxmocap.capture import Capture
from jaxmocap.geometry import unit_vectors
from jaxmocap.motion import Motion

from ._shown import Shown, gather

_JPEG_QUALITY = 75


def write_rerun(
    result: Motion | str | os.PathLike[str],
    path: str | os.PathLike[str],
    *,
    other: Motion | str | os.PathLike[str] | None = None,
    truth: str | os.PathLike[str] | None = None,
    capture: Capture | str | os.PathLike[str] | None = None,
) -> tuple[Path, tuple[str, ...]]:
    """Write an `.rrd` with what `view` shows: mesh, skeleton, cameras with images, truth, a second result, energies and
    confidence, along the video's time. Returns the path and sentences about what could not be had.

    Raises `InputError` if rerun-sdk is not installed, the suffix is another, the file exists, or something given cannot
    be used.
    """
    path = Path(path)
    if path.suffix.lower() != ".rrd":
        raise InputError(f"The recording {path} has the suffix '{path.suffix}'; a name that ends in .rrd is needed.")
    if path.exists():
        raise InputError(f"{path} exists already; choose a new file.")
    try:
        rerun = import_module("rerun")  # without types, so that static checks pass without it too
    except ImportError:
        raise InputError(
            "Recordings for Rerun need rerun-sdk, which is not installed; run pip install 'jaxmocap[rerun]'."
        ) from None
    shown = gather(result, other, truth, capture)
    try:
        with atomic_path(path) as temporary, rerun.RecordingStream("jaxmocap") as recording:
            recording.save(temporary)
            _log(recording, rerun, shown)
            recording.disconnect()  # the file is whole only then
    except OSError as error:
        raise InputError(f"{path} cannot be written ({error.strerror or error}).") from error
    return path, shown.missing


def _log(recording: Any, rr: Any, shown: Shown) -> None:
    motion = shown.motion
    axes = getattr(rr.ViewCoordinates, f"RIGHT_HAND_{motion.up.upper()}_UP")
    recording.log("world", axes, static=True)
    for index in range(len(motion)):
        recording.set_time("frame", sequence=int(motion.frames[index]))
        recording.set_time("time", duration=float(motion.timestamps[index]))
        _log_body(recording, rr, shown, "world/result", motion, index, (70, 170, 255))
        place = shown.other_at(index)
        if shown.other is not None and place is not None:
            _log_body(recording, rr, shown, "world/second_result", shown.other, place, (170, 120, 230))
        if shown.truth is not None:
            points = shown.truth[index][np.isfinite(shown.truth[index]).all(axis=1)]
            recording.log("world/truth", rr.Points3D(points, colors=(30, 160, 70), radii=0.01))
        for view, name in enumerate(shown.camera_names):
            _log_camera(recording, rr, shown, view, f"world/cameras/{rr.escape_entity_path_part(name)}", index)
        for name, values in motion.energy.items():
            if np.isfinite(values[index]):
                recording.log(f"energy/{rr.escape_entity_path_part(name)}", rr.Scalars(float(values[index])))
        recording.log("confidence", rr.Scalars(float(motion.confidence[index].mean())))


def _log_body(
    recording: Any, rr: Any, shown: Shown, path: str, motion: Motion, index: int, colour: tuple[int, int, int]
) -> None:
    mesh = rr.Mesh3D(
        vertex_positions=motion.vertices(index),
        triangle_indices=np.asarray(motion.character.faces),
        vertex_normals=_normals(motion.vertices(index), np.asarray(motion.character.faces)),
        albedo_factor=colour,
    )
    recording.log(f"{path}/mesh", mesh)
    recording.log(f"{path}/skeleton", rr.LineStrips3D(shown.bones(motion, index), radii=0.007, colors=(20, 90, 40)))


def _log_camera(recording: Any, rr: Any, shown: Shown, view: int, path: str, index: int) -> None:
    cameras = shown.motion.cameras
    assert cameras is not None  # it has names, so there are cameras
    cam_from_world = np.asarray(cameras.cam_from_world[view, index], np.float64)
    rotation = cam_from_world[:3, :3].T
    recording.log(path, rr.Transform3D(translation=-rotation @ cam_from_world[:3, 3], mat3x3=rotation))
    image, (width, height) = shown.image(view, index), cameras.sizes[view]
    scale = 1.0 if image is None else image.shape[1] / width
    k = np.diag([scale, scale, 1.0]) @ np.asarray(cameras.intrinsics[view], np.float64)
    size = (round(scale * width), round(scale * height))
    recording.log(f"{path}/image", rr.Pinhole(image_from_camera=k, resolution=size, camera_xyz=rr.ViewCoordinates.RDF))
    if image is not None:
        options = [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY]
        coded = cv2.imencode(".jpg", cv2.cvtColor(image, cv2.COLOR_RGB2BGR), options)[1]
        recording.log(f"{path}/image", rr.EncodedImage(contents=coded.tobytes(), media_type="image/jpeg"))


def _normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Area-weighted normals of the vertices."""
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    normals = np.zeros_like(vertices)
    for corner in range(3):
        np.add.at(normals, faces[:, corner], np.cross(b - a, c - a))
    return unit_vectors(normals)
