"""Small synthetic captures, each of which isolates one difficulty; the first three are the stories of Fig. 1."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from jaxmocap._files import atomic_folder, write_text
from jaxmocap._results import InputError
from jaxmocap.capture import KEYPOINT_NAMES
from jaxmocap.synthetic import SyntheticCapture, body_25, make_capture, write_capture

DETECTIONS = "keypoints_all"
_FORMAT = 1  # raise it when the generator's pictures change
STORIES: dict[str, tuple[str, dict[str, Any]]] = {
    "arms-like-torso": (
        "arms over a torso of their colour (Fig. 1a)",
        {"clothes": "uniform", "routine": "crossing arms"},
    ),
    "uniform-arm": ("a bending arm of one colour (Fig. 1b)", {"clothes": "plain sleeves", "routine": "bending arm"}),
    "background-like-arms": ("a background of the arms' colour (Fig. 1c)", {"scenery": "skin"}),
    "fast-motion": ("fast motion with motion blur", {"motion_scale": 1.5, "sub_frames": 3}),
    "changing-light": ("light that changes by 35 %", {"illumination_change": 0.35}),
    "narrow-angle": ("two cameras 6 degrees apart", {"view_angle_degrees": 6.0}),
}


@dataclass(frozen=True)
class CaptureSpec:
    """A synthetic capture by its arguments to `make_capture`; equal arguments give equal bytes."""

    name: str
    arguments: Mapping[str, Any] = field(default_factory=dict)

    @property
    def key(self) -> str:
        """The name and a digest of the arguments."""
        text = json.dumps([_FORMAT, dict(sorted(self.arguments.items()))], default=list)
        return f"{self.name}-{hashlib.sha256(text.encode()).hexdigest()[:8]}"

    def varied(self, **changes: Any) -> "CaptureSpec":
        """Film the same capture otherwise."""
        return replace(self, arguments={**self.arguments, **changes})


def story(name: str, *, quick: bool = False) -> CaptureSpec:
    """Make one of `STORIES`: 6 frames of 320 x 180 pixels if `quick`, else 30 frames of 480 x 270, both 15 per second.

    Keypoints and masks are given at five frames, of which experiments select some. Raises `InputError`
    for another name.
    """
    if name not in STORIES:
        raise InputError(f"there is no story '{name}'; choose one of {', '.join(STORIES)}.")
    frames = 6 if quick else 30
    selected = sorted({0, frames // 4, frames // 2, 3 * frames // 4, frames - 1})
    basic = {
        "num_frames": frames,
        "size": (320, 180) if quick else (480, 270),
        "fps": 15.0,
        "selected_frames": selected,
    }
    return CaptureSpec(name, {**basic, **STORIES[name][1]})


def film(spec: CaptureSpec, folder: Path) -> Path:
    """Film a capture into `folder`, once; the folder it is in.

    Beside the usual files it has `keypoints_all`, points of every frame with a detector's noise.
    """
    path = folder / spec.key
    if (path / "capture.toml").is_file():
        return path
    capture = make_capture(**dict(spec.arguments))
    try:
        with atomic_folder(path) as staging:
            write_capture(capture, staging)
            _write_detections(capture, staging / DETECTIONS)
    except OSError:
        if not (path / "capture.toml").is_file():  # else another process was quicker
            raise
    return path


def _write_detections(capture: SyntheticCapture, folder: Path) -> None:
    folder.mkdir()
    points = body_25(capture, range(capture.num_frames), noise=2.5)
    assert points.shape[2] == len(KEYPOINT_NAMES)
    for frame, views in enumerate(points):
        for camera, found in zip(capture.cameras.names, views, strict=True):
            person = {"person_id": [-1], "pose_keypoints_2d": np.round(found, 3).ravel().tolist()}
            path = folder / f"{camera}_{frame:05d}_keypoints.json"
            write_text(path, json.dumps({"version": 1.3, "people": [person]}))
