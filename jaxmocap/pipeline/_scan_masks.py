"""The person's outlines in single pictures: detected, then cut out around the built-in body."""

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import replace
from json import dumps
from pathlib import Path

import cv2
import jax
import numpy as np
from jaxtyping import Bool, Float, PRNGKeyArray

from jaxmocap._results import InputError
from jaxmocap.camera import Cameras, write_cameras
from jaxmocap.capture import Capture

from ._defaults import with_person_masks
from ._detect import detect
from ._made_to_measure import character_of

Say = Callable[[str], None]


def find_outlines(
    files: Sequence[Path], cameras: Cameras, height: float, key: PRNGKeyArray, say: Say | None = None
) -> Bool[np.ndarray, "view height width"]:
    """Find the person in pictures that show one moment, as masks without distortion.

    The pictures become the cameras of a capture of one frame: a detector finds keypoints, the built-in body, `height`
    metres tall, is registered to them, and colours decide along its outline. `cameras` are in metres.
    Raises `InputError` where the detector cannot be had or finds nobody.
    """
    tell = say or (lambda sentence: None)
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        for file in files:
            (folder / file.name).write_bytes(file.read_bytes())
        write_cameras(replace(cameras, cam_from_world=_upright(cameras)), folder / "cameras.toml", "aniposelib")
        sections = [f"\n[[camera]]\nname = {dumps(file.stem)}\nvideo = {dumps(file.name)}\n" for file in files]
        head = 'name = "scan"\nfps = 25\nframes = 1\nunits = "metres"\nup = "y"\ncameras = "cameras.toml"\n'
        (folder / "capture.toml").write_text(head + "selected_frames = [0]\n" + "".join(sections), encoding="utf-8")
        detect(folder, say=tell)
        capture = Capture.open(folder)
        character = character_of(capture, height=height, key=key).character
        tell("The masks are found: the person is detected, and cut out around the built-in body.")
        complete, _ = with_person_masks(capture, character, key=key)
        masks = [complete.mask(camera, 0) for camera in range(len(files))]
    for file, mask in zip(files, masks, strict=True):
        if mask is None or not mask.any():
            raise InputError(f"nobody is found in {file}; take the picture out, or give masks with --masks.")
    return np.stack([_enlarged(mask, size) for mask, size in zip(masks, cameras.sizes, strict=True)])


def _enlarged(mask: Bool[np.ndarray, "_ _"], size: tuple[int, int]) -> Bool[np.ndarray, "height width"]:
    """Bring a mask to the size of its picture: a capture works on smaller ones where pictures are large."""
    return cv2.resize(mask.astype(np.float32), size, interpolation=cv2.INTER_LINEAR) > 0.5


def _upright(cameras: Cameras) -> Float[jax.Array, "camera frame 4 4"]:
    """Turn the world so that y points to where the cameras' upper edges do in the mean."""
    poses = np.array(cameras.cam_from_world, np.float64)
    up = -poses[:, 0, 1, :3].mean(0)
    up = up / np.linalg.norm(up)
    side = np.cross(up, np.eye(3)[np.argmin(np.abs(up))])
    side = side / np.linalg.norm(side)
    world_from_new = np.stack([side, up, np.cross(side, up)], axis=1)
    poses[..., :3, :3] = poses[..., :3, :3] @ world_from_new
    return jax.device_put(poses.astype(np.float32))
