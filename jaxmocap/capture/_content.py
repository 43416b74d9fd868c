"""What a capture holds, as one hash: the same for a copy under another name, another for one changed pixel."""

import hashlib
from pathlib import Path

import numpy as np

from jaxmocap._cache import digest
from jaxmocap._files import is_clutter

from ._capture import Capture
from ._picture_steps import mask_file

_CHUNK = 1 << 20


def content_hash(capture: Capture) -> str:
    """Hash the videos, the cameras, the keypoints, the masks, the silhouettes and the settings of `capture.toml` that
    matter for tracking; not of comments, names of files, or the truth. Reads every video once."""
    settings = (capture.up, capture.metres_per_unit, capture.selected_frames, capture.offsets, capture.camera_names)
    layout = () if capture.keypoint_layout is None else (capture.keypoint_layout,)
    cameras = None if capture.cameras_path is None else capture.cameras
    found = hashlib.blake2b(digest((settings, capture.video_frames, cameras, *layout)).encode(), digest_size=16)
    for video in capture.videos:
        _add(found, "video", video)
    sources = [capture.video_keypoints(camera) for camera in range(capture.num_cameras)]
    for frame in range(capture.num_frames):
        for camera, name in enumerate(capture.camera_names):
            own, source = int(capture.video_frames[camera, frame]), sources[camera]
            points = None if source is None else source.frame_file(own)
            mask = None if capture.masks_folder is None else mask_file(capture.masks_folder, name, own)
            shown = None if capture.silhouettes_folder is None else mask_file(capture.silhouettes_folder, name, own)
            for kind, path in (("keypoints", points), ("mask", mask), ("silhouette", shown)):
                if path is not None and path.is_file():
                    _add(found, f"{kind} {camera} {frame}", path)
    for camera, source in enumerate(sources):
        if source is not None and (path := source.video_file()) is not None:
            _add(found, f"keypoints {camera}", path)
    for (camera, frame), mask in sorted(capture.found_masks.items()):
        found.update(f"found mask {camera} {frame} {mask.shape}".encode() + np.packbits(mask).tobytes())
    return found.hexdigest()


def path_hash(path: Path) -> str:
    """Hash a file's content, or all files of a folder and the folders in it, by name; not what file managers leave."""
    found = hashlib.blake2b(digest_size=16)
    for file in sorted(path.rglob("*")) if path.is_dir() else [path]:
        name = file.relative_to(path)
        if file.is_file() and not any(map(is_clutter, name.parts)):
            _add(found, name.as_posix(), file)
    return found.hexdigest()


def _add(found: "hashlib.blake2b", name: str, path: Path) -> None:
    found.update(f"{name} {path.stat().st_size} ".encode())
    with path.open("rb") as file:
        while chunk := file.read(_CHUNK):
            found.update(chunk)
