"""The person in single pictures: detected, measured, and cut out around the built-in body."""

import shutil
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from json import dumps
from pathlib import Path
from typing import NamedTuple

import cv2
import jax
import numpy as np
from jaxtyping import Bool, Float, PRNGKeyArray

from jaxmocap._results import InputError
from jaxmocap._types import Report, Say
from jaxmocap.calibration import PARTS_OF_HEIGHT, SubjectView, fit_scale, triangulate_views
from jaxmocap.camera import Cameras, look_at_point, world_from_upright, write_cameras
from jaxmocap.capture import Capture, Undistortion, camera_names, video_names
from jaxmocap.geometry import camera_centres
from jaxmocap.registration import PersonMask

from ._defaults import with_person_masks
from ._detect import detect
from ._made_to_measure import character_of

MOVED = 0.06
"""Metres that joints of a person who stands still may lie from where all pictures put them, in the median."""

MEASURED = 16
"""Views, at most, that the built-in body is made to measure in; more tell hardly anything and take longer."""

_USUAL_DISTANCE = 2.5  # metres from camera to person, until the person tells the scale
_CONFIDENT = 0.3
_CAMERA = "\n[[camera]]\n"


class Outlines(NamedTuple):
    """The person in pictures.

    Attributes:
        used: numbers of the pictures in which the person is found; the rest of the record is of these alone.
        masks: without distortion.
        people: the same in the size that they were found in, and how sure they are.
        cameras: in metres, as the person's height says.
    """

    used: tuple[int, ...]
    masks: Bool[np.ndarray, "view height width"]
    people: tuple[PersonMask, ...]
    cameras: Cameras


def find_outlines(
    files: Sequence[Path],
    cameras: Cameras,
    height: float,
    key: PRNGKeyArray,
    weights: str | Path | None = None,
    say: Say = lambda sentence: None,
    progress: Report = lambda stage, done, total: None,
) -> Outlines:
    """Find the person in pictures of one moment, or of somebody who stands still.

    The pictures become the cameras of a capture of one frame: a detector finds keypoints of the person whom the cameras
    look at, whose bones tell about the scale of the cameras' world from the person's `height` in metres; the built-in
    body is made to measure, which tells it better, and colours decide along its outline. Pictures in which nobody is
    found are left out, and named. Raises `InputError` where the detector cannot be had or finds nobody in half of the
    pictures, and where the person moved.
    """
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        names = camera_names(files)
        videos = video_names(files, names)
        for name, file in videos.items():
            shutil.copyfile(file, folder / name)
        pictures = dict(zip(names, videos, strict=True))
        upright = replace(cameras, names=tuple(names), cam_from_world=_upright(cameras))
        poses = np.asarray(upright.cam_from_world, np.float64)[:, 0]
        upright = _scaled(upright, _USUAL_DISTANCE / _distance(poses))
        _write_capture(folder, pictures, upright)
        crowded = _detect(folder, upright, weights, say, progress)
        seen = _keypoints(Capture.open(folder))
        used = _showing(files, seen, say)
        if len(used) < len(files):
            _keep_views(folder / "capture.toml", used)
            files, seen, upright = [files[view] for view in used], seen[used], upright.only(used)
            crowded = [used.index(view) for view in crowded]
            pictures = {name: pictures[name] for name in upright.names}
        upright = _scaled(upright, person_scale(upright, seen, height, [files[view].name for view in crowded]))
        _write_capture(folder, pictures, upright)
        few = Capture.open(_measured_views(folder / "capture.toml"))
        made = character_of(few, height=height, scale_cameras=True, key=key, progress=progress)
        upright = _scaled(upright, made.camera_scale)
        _write_capture(folder, pictures, upright)
        say("The masks are found: the person is detected, and cut out around the built-in body.")
        _, found = with_person_masks(Capture.open(folder), made.character, key=key, progress=progress)
    people = found[0]
    for file, one in zip(files, people, strict=True):
        if not one.mask.any():
            raise InputError(f"nobody is found in {file.name}; take the picture out, or give masks with --masks.")
    pairs = zip(people, upright.sizes, strict=True)
    return Outlines(tuple(used), np.stack([_enlarged(one.mask, size) for one, size in pairs]), people, upright)


def _showing(files: Sequence[Path], keypoints: Float[np.ndarray, "view 25 3"], say: Say) -> list[int]:
    """List the pictures in which somebody is found, and say which are left out."""
    shown = [bool((points[:, 2] > 0).any()) for points in keypoints]
    names = [file.name for file, seen in zip(files, shown, strict=True) if not seen]
    if 2 * len(names) >= len(files):
        raise InputError(
            f"nobody is found in {len(names)} of {len(files)} pictures (first {names[0]}); show the whole person, not "
            "too small, or give masks with --masks."
        )
    if names:
        say(f"Nobody is found in {', '.join(names)}: left out.")
    return [view for view, seen in enumerate(shown) if seen]


def _detect(folder: Path, cameras: Cameras, weights: str | Path | None, say: Say, progress: Report) -> list[int]:
    """Find the keypoints of the person in the middle of what the cameras look at; return the views that show others."""
    poses = np.asarray(cameras.cam_from_world, np.float64)[:, 0]
    middle = look_at_point(poses)
    at = {}
    for view, (name, size) in enumerate(zip(cameras.names, cameras.sizes, strict=True)):
        intrinsics = np.asarray(cameras.intrinsics, np.float64)[view]
        image = intrinsics @ (poses[view, :3, :3] @ middle + poses[view, :3, 3])
        lens = Undistortion(intrinsics, np.asarray(cameras.distortion)[view], size)
        pixel = lens.recorded_points(image[None, :2] / image[2])[0]
        at[name] = tuple(np.clip(pixel, 0, np.array(size) - 1))
    of_views = tuple(f"{name}: " for name in cameras.names)
    tell = lambda sentence: None if sentence.startswith(of_views) else say(sentence)  # noqa: E731 - forty alike
    found = detect(folder, weights=weights, person=at, skip_empty=True, say=tell, progress=progress)
    record = found.record["cameras"]
    crowded = [view for view, name in enumerate(cameras.names) if name in record and record[name]["notes"]]
    if crowded:
        say(
            f"Several people are seen in {len(crowded)} of {len(at)} pictures; the one in the middle of what the "
            "cameras look at is scanned."
        )
    return crowded


def _write_capture(folder: Path, pictures: Mapping[str, str], cameras: Cameras) -> None:
    """Write cameras and, once, `capture.toml`, to which detection adds the keypoints."""
    write_cameras(replace(cameras, names=tuple(pictures)), folder / "cameras.toml", "aniposelib")
    if (folder / "capture.toml").exists():
        return
    sections = [f"{_CAMERA}name = {dumps(name)}\nvideo = {dumps(file)}\n" for name, file in pictures.items()]
    head = 'name = "scan"\nfps = 25\nframes = 1\nunits = "metres"\nup = "y"\ncameras = "cameras.toml"\n'
    (folder / "capture.toml").write_text(head + "selected_frames = [0]\n" + "".join(sections), encoding="utf-8")


def _keep_views(file: Path, chosen: Sequence[int]) -> None:
    """Leave the other views out of a capture."""
    head, *cameras = file.read_text(encoding="utf-8").split(_CAMERA)
    file.write_text(_CAMERA.join([head, *(cameras[view] for view in chosen)]), encoding="utf-8")


def _measured_views(file: Path) -> Path:
    """Write beside a capture one of up to `MEASURED` of its views, evenly chosen."""
    few = Path(shutil.copyfile(file, file.with_name("measured.toml")))
    count = file.read_text(encoding="utf-8").count(_CAMERA)
    _keep_views(few, range(0, count, -(-count // MEASURED)))
    return few


def person_scale(
    cameras: Cameras, keypoints: Float[np.ndarray, "view 25 3"], height: float, crowded: Sequence[str] = ()
) -> float:
    """Measure metres per unit of the cameras' world by the bones of a person of this height, from keypoints (BODY_25,
    pixels without distortion).

    Raises `InputError` where two views do not show enough of them, and for a person who moved from view to view, or
    who is not the same in all of them, where others are seen in `crowded` pictures.
    """
    intrinsics = np.asarray(cameras.intrinsics, np.float64)
    view = SubjectView(intrinsics, np.asarray(cameras.cam_from_world, np.float64)[:, 0], keypoints)
    lengths = {name: part * height for name, part in PARTS_OF_HEIGHT.items()}
    scale = fit_scale([view], lengths, "height", max(cameras.sizes[0]))
    if scale is None:
        raise InputError(
            "the person's arms and legs are not seen well enough in two pictures to tell the size; show the whole "
            "person, arms a little away, or give cameras in metres and masks."
        )
    moved = scale.metres_per_unit * _apart(view)
    if moved > MOVED and crowded:
        raise InputError(
            f"several people are seen in {len(crowded)} of {len(keypoints)} pictures (first {crowded[0]}), and those "
            "in the middle are not one person who stands still: joints are "
            f"{100 * moved:.0f} cm in the median from where all pictures together put them; keep the person in the "
            "middle while the camera goes around, best with nobody else in sight, or give pictures and masks."
        )
    if moved > MOVED:
        raise InputError(
            f"the person did not stand still: joints are {100 * moved:.0f} cm in the median from where all pictures "
            "together put them; stand still with arms a little away from the body while the camera goes around. "
            "Where nobody moved, the cameras are not those of the pictures."
        )
    return scale.metres_per_unit


def _keypoints(capture: Capture) -> Float[np.ndarray, "view 25 3"]:
    """Read the keypoints of a capture of one frame, distortion taken out; confidence 0 where there are none."""
    recorded = capture.as_recorded()
    cameras, keypoints = recorded.cameras, np.zeros((recorded.num_cameras, 25, 3))
    for number, size in enumerate(recorded.sizes):
        found = recorded.keypoints(number, 0)
        if found is not None:
            lens = Undistortion(np.asarray(cameras.intrinsics)[number], np.asarray(cameras.distortion)[number], size)
            keypoints[number] = found
            keypoints[number, :, :2] = lens.points(found[:, :2])
    return keypoints


def _apart(view: SubjectView) -> float:
    """Measure how far the rays of keypoints pass from where all views put the joint, in the median."""
    points = triangulate_views(view)
    distances = []
    for intrinsics, pose, found in zip(view.intrinsics, view.cam_from_world, view.keypoints, strict=True):
        known = np.isfinite(points).all(-1) & (found[:, 2] >= _CONFIDENT)
        local = points[known] @ pose[:3, :3].T + pose[:3, 3]
        image = local @ intrinsics.T
        off = image[:, :2] / image[:, 2:] - found[known, :2]
        distances.append(np.linalg.norm(off, axis=-1) * local[:, 2] / intrinsics[0, 0])
    return float(np.median(np.concatenate(distances)))


def _distance(poses: Float[np.ndarray, "view 4 4"]) -> float:
    """Measure the distance from the cameras to what they all look at, in the median."""
    return float(np.median(np.linalg.norm(camera_centres(poses) - look_at_point(poses), axis=-1)))


def _scaled(cameras: Cameras, factor: float) -> Cameras:
    return replace(cameras, cam_from_world=cameras.cam_from_world.at[..., :3, 3].multiply(factor))


def _enlarged(mask: Bool[np.ndarray, "_ _"], size: tuple[int, int]) -> Bool[np.ndarray, "height width"]:
    """Bring a mask to the size of its picture: a capture works on smaller ones where pictures are large."""
    return cv2.resize(mask.astype(np.float32), size, interpolation=cv2.INTER_LINEAR) > 0.5


def _upright(cameras: Cameras) -> Float[jax.Array, "camera frame 4 4"]:
    """Turn the world so that y points to where the cameras' upper edges do in the mean."""
    poses = np.array(cameras.cam_from_world, np.float64)
    poses[..., :3, :3] = poses[..., :3, :3] @ world_from_upright(poses[:, 0])
    return jax.device_put(poses.astype(np.float32))
