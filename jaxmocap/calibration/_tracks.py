"""The background that a calibration was made of: the tracks of its model."""

import json
import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxmocap.camera import colmap_files, read_colmap_points
from jaxmocap.capture import Capture, Undistortion

from ._child import Report, run_worker


class Tracks(NamedTuple):
    """Images of a model by name, with their camera, the frame of its own video and the pose; points, and sightings of
    them in pixels without distortion; metres. Without a model, or one without points, poses are the capture's at its
    shared frames, and there are no names and no points."""

    names: tuple[str, ...]
    camera: Int[np.ndarray, " pose"]
    frame: Int[np.ndarray, " pose"]
    cam_from_world: Float[np.ndarray, "pose 4 4"]
    points: Float[np.ndarray, "point 3"]
    pose_of: Int[np.ndarray, " sighting"]
    point_of: Int[np.ndarray, " sighting"]
    pixels: Float[np.ndarray, "sighting 2"]


def read_tracks(capture: Capture, progress: Report) -> Tracks:
    """The tracks of the model that `capture.toml` names. Raises `InputError` if it cannot be read."""
    folder = capture.cameras_path
    if folder is not None and not folder.is_dir():
        folder = folder.parent
    if folder is not None and colmap_files(folder) is not None and len(read_colmap_points(folder)[0]):
        return _from_model(capture, folder, progress)
    cameras, frames = capture.video_frames.shape
    poses = np.asarray(capture.cameras.cam_from_world, float).reshape(-1, 4, 4)
    camera, none = np.repeat(np.arange(cameras), frames), np.zeros(0, int)
    return Tracks((), camera, capture.video_frames.reshape(-1), poses, np.zeros((0, 3)), none, none, np.zeros((0, 2)))


def _from_model(capture: Capture, folder: Path, progress: Report) -> Tracks:
    with tempfile.TemporaryDirectory(prefix="jaxmocap-") as temporary:
        work = Path(temporary)
        (work / "model.json").write_text(json.dumps(str(folder.resolve())), encoding="utf-8")
        run_worker("tracks", work, progress)
        with np.load(work / "tracks.npz", allow_pickle=False) as arrays:
            table = dict(arrays)
    places = [name.rsplit("/", 1) for name in table["names"].tolist()]
    numbers = {name: index for index, name in enumerate(capture.camera_names)}
    kept = np.array([len(place) == 2 and place[0] in numbers for place in places], bool)
    camera = np.array([numbers[place[0]] for place, keep in zip(places, kept, strict=True) if keep], int)
    frame = np.array([int(place[1].split(".")[0]) for place, keep in zip(places, kept, strict=True) if keep], int)
    lengths = np.array([index.num_frames for index in capture.indices])
    renumbered = np.cumsum(kept) - 1
    seen = kept[table["pose_of"]]
    pose_of, point_of = renumbered[table["pose_of"][seen]], table["point_of"][seen]
    pixels = table["pixels"][seen].copy()
    for index in range(capture.num_cameras):
        lens = _lens(capture, index)
        mine = camera[pose_of] == index
        if lens is not None and mine.any():
            pixels[mine] = lens.points(pixels[mine])
    inside = frame[pose_of] < lengths[camera[pose_of]]
    poses = table["cam_from_world"][kept]
    poses[:, :3, 3] *= capture.metres_per_unit
    names = tuple(name for name, keep in zip(table["names"].tolist(), kept, strict=True) if keep)
    points = capture.metres_per_unit * table["points"]
    return Tracks(names, camera, frame, poses, points, pose_of[inside], point_of[inside], pixels[inside])


def _lens(capture: Capture, camera: int) -> Undistortion | None:
    distortion = np.asarray(capture.cameras.distortion[camera])
    if not distortion.any():
        return None
    return Undistortion(np.asarray(capture.cameras.intrinsics[camera]), distortion, capture.sizes[camera])
