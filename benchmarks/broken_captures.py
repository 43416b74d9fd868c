"""Captures that are wrong on purpose: copies of a good one, half as large, with one mistake that people make."""

import json
import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import jax.numpy as jnp
import numpy as np

from jaxmocap.camera import Cameras, write_colmap_text
from jaxmocap.capture import KEYPOINT_NAMES, Capture
from jaxmocap.geometry import so3_exp
from jaxmocap.metrics import Truth
from jaxmocap.viewers import open_video

KEYPOINT_NOISE = 3.0
"""Pixels, of keypoints that the copied capture needs and the good one does not have."""

SCALE = 0.5
"""Of the copies, which are tracked several times as fast."""

_PLACES = {"pelvis": ("l_hip", "r_hip")}


def copied(source: Path, folder: Path) -> Path:
    """Nothing is wrong."""
    return _write(Capture.open(source), folder)


def wrong_focal_length(source: Path, folder: Path, factor: float = 1.2) -> Path:
    """Every camera's focal length multiplied."""
    capture = Capture.open(source)
    intrinsics = capture.cameras.intrinsics.at[:, [0, 1], [0, 1]].multiply(factor)
    return _write(capture, folder, cameras=replace(capture.cameras, intrinsics=intrinsics))


def swapped_cameras(source: Path, folder: Path) -> Path:
    """The first two cameras have each other's calibration."""
    capture = Capture.open(source)
    order, cameras = jnp.array([1, 0, *range(2, capture.num_cameras)]), capture.cameras
    swapped = replace(cameras, intrinsics=cameras.intrinsics[order], cam_from_world=cameras.cam_from_world[order])
    return _write(capture, folder, cameras=swapped)


def turned_camera(source: Path, folder: Path, degrees: float = 2.0) -> Path:
    """The second camera has been pushed: it looks some degrees aside, about all three axes."""
    capture = Capture.open(source)
    turn = jnp.eye(4).at[:3, :3].set(so3_exp(jnp.full(3, np.radians(degrees) / np.sqrt(3))))
    poses = capture.cameras.cam_from_world
    return _write(capture, folder, cameras=replace(capture.cameras, cam_from_world=poses.at[1].set(turn @ poses[1])))


def late_camera(source: Path, folder: Path, seconds: float = 0.2) -> Path:
    """The second camera started later, and nobody knows; it moves as its pictures say."""
    capture = Capture.open(source)
    late = round(seconds * capture.fps)
    ahead = np.arange(capture.num_frames - late)
    frames = [ahead + late if camera == 1 else ahead for camera in range(capture.num_cameras)]
    return _write(capture, folder, frames=frames, posed=frames)


def stopped_camera(source: Path, folder: Path, frame: int) -> Path:
    """The second camera's picture stands still from a frame on, after the selected frames."""
    capture = Capture.open(source)
    ahead = np.arange(capture.num_frames)
    frames = [np.minimum(ahead, frame) if camera == 1 else ahead for camera in range(capture.num_cameras)]
    return _write(capture, folder, frames=frames)


def one_camera(source: Path, folder: Path) -> Path:
    """The first camera alone."""
    toml = copied(source, folder) / "capture.toml"
    toml.write_text("\n[[camera]]".join(toml.read_text().split("\n[[camera]]")[:2]))
    return folder


def looped(source: Path, folder: Path, count: int, length: int = 30) -> Path:
    """Nothing is wrong, but it lasts: the first `length` frames forwards and backwards until there are `count`."""
    capture = Capture.open(source).with_selected_frames((0,))
    there_and_back = np.concatenate([np.arange(length), np.arange(length - 2, 0, -1)])
    order = np.resize(there_and_back, count)
    frames = [order] * capture.num_cameras
    _write(capture, folder, frames=frames, posed=frames)
    with np.load(folder / "truth.npz", allow_pickle=False) as truth:
        long = {name: a[order] if a.shape[:1] == (capture.num_frames,) else a for name, a in truth.items()}
    np.savez(folder / "truth.npz", **long)
    return folder


def other_actor(source: Path, folder: Path, actor: Path) -> Path:
    """Somebody else's mesh."""
    return _write(Capture.open(source), folder, actor=actor)


def _write(
    capture: Capture,
    folder: Path,
    *,
    cameras: Cameras | None = None,
    frames: Sequence[np.ndarray] | None = None,
    posed: Sequence[np.ndarray] | None = None,
    actor: Path | None = None,
) -> Path:
    """A copy, undistorted. Camera c shows the frames `frames[c]` of the capture and is said to be
    where it was at the frames `posed[c]`; with other cameras or another actor if they are given."""
    ahead = [np.arange(capture.num_frames) for _ in range(capture.num_cameras)]
    frames, posed = ahead if frames is None else frames, ahead if posed is None else posed
    actor = capture.actor if actor is None else actor
    assert actor is not None
    assert capture.truth is not None
    cameras = _smaller(capture.cameras if cameras is None else cameras, posed)
    for part in ("keypoints", "masks"):
        (folder / part).mkdir(parents=True)
    shutil.copyfile(actor, folder / f"actor{actor.suffix}")
    write_colmap_text(cameras, folder / "cameras")
    shutil.copyfile(capture.truth, folder / "truth.npz")
    selected, entries = [f for f in capture.selected_frames or (0,) if f < len(frames[0])], ""
    for camera, (name, size) in enumerate(zip(capture.camera_names, cameras.sizes, strict=True)):
        entries += f'\n[[camera]]\nname = "{name}"\nvideo = "{name}.mp4"\n'
        with open_video(folder / f"{name}.mp4", quality=10) as video:
            for number, frame in enumerate(frames[camera]):
                image = cv2.resize(capture.image(camera, int(frame)), size, interpolation=cv2.INTER_AREA)
                video.write(number / capture.fps, image)
        for frame in selected:
            points = _points(capture, camera, int(frames[camera][frame]))
            points[:, :2] *= SCALE
            people = [{"person_id": [-1], "pose_keypoints_2d": points.round(3).ravel().tolist()}]
            file = folder / "keypoints" / f"{name}_{frame:05d}_keypoints.json"
            file.write_text(json.dumps({"version": 1.3, "people": people}))
            mask = capture.mask(camera, int(frames[camera][frame]))
            if mask is not None:
                small = cv2.resize(255 * mask.astype(np.uint8), size, interpolation=cv2.INTER_AREA)
                cv2.imwrite(str(folder / "masks" / f"{name}_{frame:05d}.png"), small)
    (folder / "capture.toml").write_text(
        f'name = "{folder.name}"\nfps = {capture.fps:g}\nframes = {len(frames[0])}\nup = "{capture.up}"\n'
        f'actor = "actor{actor.suffix}"\ncameras = "cameras"\nselected_frames = {selected}\n'
        f'keypoints = "keypoints"\nmasks = "masks"\ntruth = "truth.npz"\n{entries}'
    )
    return folder


def _smaller(cameras: Cameras, posed: Sequence[np.ndarray]) -> Cameras:
    """The cameras at some frames, for smaller images without distortion."""
    return replace(
        cameras,
        sizes=tuple((_even(width), _even(height)) for width, height in cameras.sizes),
        intrinsics=cameras.intrinsics * jnp.array([SCALE, SCALE, 1])[:, None],
        distortion=jnp.zeros_like(cameras.distortion),
        cam_from_world=jnp.stack([cameras.cam_from_world[camera, frames] for camera, frames in enumerate(posed)]),
    )


def _even(length: int) -> int:
    return 2 * round(SCALE * length / 2)


def _points(capture: Capture, camera: int, frame: int) -> np.ndarray:
    """The capture's keypoints of a frame, or else its true joints as a detector would see them."""
    known = capture.keypoints(camera, frame)
    if known is not None:
        return known
    assert capture.truth is not None
    truth, points = Truth.read(capture.truth), np.zeros((25, 3))
    assert truth.joints is not None
    view, names = capture.cameras.at(frame), list(truth.joint_names)
    noise = KEYPOINT_NOISE * np.random.default_rng([camera, frame]).standard_normal((25, 2))
    for index, name in enumerate(KEYPOINT_NAMES):
        places = [place for place in _PLACES.get(name, (name,)) if place in names]
        if places:
            joint = truth.joints[frame, [names.index(place) for place in places]].mean(0)
            local = np.asarray(view.cam_from_world[camera]) @ np.append(joint, 1)
            pixel = np.asarray(view.intrinsics[camera]) @ local[:3]
            points[index] = [*(pixel[:2] / pixel[2] + noise[index]), 1]
    return points
