"""What shows where the cameras are: the background's tracks in a calibrated model, and the body that was tracked."""

import json
import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.interpolate import CubicSpline
from scipy.signal import savgol_filter

from jaxmocap._results import InputError
from jaxmocap.camera import colmap_files, read_colmap_points
from jaxmocap.capture import Capture, Detections, Undistortion
from jaxmocap.motion import Motion
from jaxmocap.observation import BODY_25, nearest_person

from ._child import run_worker
from ._footage import CONFIDENT, Report
from ._joint_scene import Body

_FEWEST_FRAMES = 5
_FEWEST_POINTS = 8
_OTHER_CAMERAS = 0.03  # metres between the cameras of a result and of the capture


class Tracks(NamedTuple):
    """The background's tracks in a calibrated model.

    Without a model, or one without points, poses are the capture's at its shared frames, and there are no names and no
    points.

    Attributes:
        names: of the images.
        camera: of each image.
        frame: of its own video.
        cam_from_world: poses, metres.
        points: metres.
        pose_of: the image of each sighting.
        point_of: the point it is of.
        pixels: the lenses' distortion taken out.
    """

    names: tuple[str, ...]
    camera: Int[np.ndarray, " pose"]
    frame: Int[np.ndarray, " pose"]
    cam_from_world: Float[np.ndarray, "pose 4 4"]
    points: Float[np.ndarray, "point 3"]
    pose_of: Int[np.ndarray, " sighting"]
    point_of: Int[np.ndarray, " sighting"]
    pixels: Float[np.ndarray, "sighting 2"]


def read_tracks(capture: Capture, progress: Report) -> Tracks:
    """Read the tracks of the model that `capture.toml` names. Raises `InputError` if it cannot be read."""
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


class BodySightings(NamedTuple):
    """Body points that two cameras or more see.

    Attributes:
        body: how they move.
        points: their tracked places, metres.
        camera: of each sighting.
        position: of its frame among the capture's shared frames.
        point_of: the point it is of.
        pixels: the lenses' distortion taken out.
        alike: how many neighbouring frames share a detector's error.
    """

    body: Body
    points: Float[np.ndarray, "body 3"]
    camera: Int[np.ndarray, " sighting"]
    position: Int[np.ndarray, " sighting"]
    point_of: Int[np.ndarray, " sighting"]
    pixels: Float[np.ndarray, "sighting 2"]
    alike: float


def body_sightings(capture: Capture, motion: Motion, detections: str | Path | None) -> BodySightings:
    """Read the keypoints, the capture's or those of `detections`, at the tracked frames.

    Raises `InputError` where the motion is of another capture or other cameras, or where two views have too few
    keypoints.
    """
    position = _positions(capture, motion)
    tracks = {point: parts for point, parts in BODY_25.items() if set(parts) <= set(motion.joint_names)}
    parts = [[motion.joint_names.index(part) for part in names] for names in tracks.values()]
    places = np.stack([np.asarray(motion.joints, float)[:, part].mean(axis=1) for part in parts], axis=1)
    times = capture.timestamps[position]
    path = CubicSpline(times, savgol_filter(places, _FEWEST_FRAMES, 2, axis=0))
    folder = None if detections is None else Detections.open(capture, detections).folder
    rows, frames, points, index = [], set(), [], []
    for row, frame in enumerate(position):
        if motion.status[row] == "lost":
            continue
        seen = _keypoints(capture, int(frame), places[row], list(tracks), folder)
        for track in np.flatnonzero((seen[..., 2] >= CONFIDENT).sum(axis=0) >= 2):
            for camera in np.flatnonzero(seen[:, track, 2] >= CONFIDENT):
                rows.append((camera, frame, len(points), *seen[camera, track, :2]))
            points.append(places[row, track])
            index.append((track, times[row]))
            frames.add(int(frame))
    if len(points) < _FEWEST_POINTS:
        raise InputError(
            f"capture '{capture.name}' has {len(points)} keypoints of the tracked body that two cameras see, at least "
            f"{_FEWEST_POINTS} are needed to refine its cameras: give a folder of a detector's keypoints with "
            "--detections"
        )
    table, which = np.array(rows), np.array(index)
    body = Body(path, float(times[0]), float(times[-1]), which[:, 0].astype(int), which[:, 1])
    near = [sum(abs(one - other) <= capture.fps / 8 for other in frames) for one in frames]
    camera, at, point = table[:, :3].astype(int).T
    return BodySightings(body, np.array(points), camera, at, point, table[:, 3:], float(np.mean(near)))


def _positions(capture: Capture, motion: Motion) -> Int[np.ndarray, " frame"]:
    """Find the motion's frames in the capture: their positions."""
    own = capture.video_frames[0]
    position = np.searchsorted(own, motion.frames)
    if len(motion) < _FEWEST_FRAMES or (position >= len(own)).any() or (own[position] != motion.frames).any():
        raise InputError(
            f"the result has {len(motion)} frames, {motion.frames[0]} to {motion.frames[-1]}, that are not all among "
            f"the {len(own)} of capture '{capture.name}', {own[0]} to {own[-1]}, or fewer than {_FEWEST_FRAMES}; give "
            "the result of tracking this capture"
        )
    if motion.cameras is not None and motion.cameras.num_cameras == capture.num_cameras:
        apart = np.asarray(motion.cameras.centres()) - np.asarray(capture.cameras.centres())[:, position]
        if float(np.abs(apart).max()) <= _OTHER_CAMERAS:
            return position
    elif motion.cameras is None:
        return position
    raise InputError(
        f"the result was tracked with other cameras than those of capture '{capture.name}'; track it again, or name "
        "the cameras it was tracked with in capture.toml"
    )


def _keypoints(
    capture: Capture, frame: int, places: np.ndarray, points: list[int], folder: Path | None
) -> Float[np.ndarray, "camera track 3"]:
    """Read what each camera's detector saw of the person nearest to the tracked one; confidence 0 where nothing."""
    view = capture.cameras.at(frame)
    result = np.zeros((capture.num_cameras, len(points), 3))
    for camera in range(capture.num_cameras):
        pose, matrix = np.asarray(view.cam_from_world[camera], float), np.asarray(view.intrinsics[camera], float)
        image = (places @ pose[:3, :3].T + pose[:3, 3]) @ matrix.T
        expected = np.full((25, 2), np.nan)
        expected[points] = image[:, :2] / image[:, 2:]
        person = nearest_person(capture.people(camera, frame, folder), expected)
        if person is not None:
            result[camera] = person[points]
    return result
