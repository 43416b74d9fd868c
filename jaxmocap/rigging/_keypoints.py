"""Keypoints that a detector has found in pictures of a mesh, from files to pins."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxmocap._results import InputError
from jaxmocap.camera import Cameras, read_cameras
from jaxmocap.detection import best_person, read_people
from jaxmocap.geometry import unit

from ._fit_template import Pin
from ._picture_cameras import CAMERAS_FILE, VIEWS, metres_per_unit_of
from ._seen_joints import JOINTS, UNSURE, Seen, joint_pins, look

_SUFFIX = "_keypoints.json"
_FEWEST = 6  # joints
_OUTSIDE = 0.02  # of the picture, by which a point may lie outside
_BESIDE = 0.1  # metres at the template's height, beside the mesh
_AGAIN = "run the detector on the pictures that --pictures drew of this mesh, in their full size"


class Hints(NamedTuple):
    """What keypoints tell about a mesh, in its own units and axes.

    Attributes:
        pins: where joints are, by name.
        up: a direction; None where the trunk is not seen.
        front: a direction; None where the trunk is not seen.
        views: the pictures they come from.
    """

    pins: dict[str, Pin]
    up: Float[np.ndarray, "3"] | None
    front: Float[np.ndarray, "3"] | None
    views: tuple[str, ...]


def read_hints(path: str | Path, vertices: Float[np.ndarray, "vertex 3"], faces: Int[np.ndarray, "face 3"]) -> Hints:
    """Read hints from keypoint files, of any layout, beside the cameras of the pictures of a repaired mesh.

    `path` is the folder, whose files are named after the pictures (`front_keypoints.json`), or one such file. Raises
    `InputError` for what is missing or damaged, and for keypoints of other pictures than those of this mesh.
    """
    files, folder = _files(Path(path))
    scale = metres_per_unit_of(vertices)
    cameras = _cameras(folder / CAMERAS_FILE, tuple(files), scale)
    people = [_person(file, size) for file, size in zip(files.values(), cameras.sizes, strict=True)]
    if all(points is None for points in people):
        raise InputError(f"{path}: the detector found nobody in {_listed(files)}; give single joints with --joint.")
    points = np.stack([np.zeros((25, 3)) if found is None else found for found in people])
    for number, (name, file) in enumerate(files.items()):
        _check_inside(file, name, points[number], cameras.sizes[number])
    seen = look(cameras.at(0), points, scale * vertices, faces)
    _check_on_mesh(seen, tuple(files.values()))
    pins = joint_pins(seen)
    if len(pins) < _FEWEST:
        raise InputError(f"{path} shows {len(pins)} joints; at least {_FEWEST} of the {len(JOINTS)} are needed.")
    up, front = _directions(pins)
    in_file = {name: Pin(pin.place / scale, pin.information * scale**2, pin.doubted) for name, pin in pins.items()}
    return Hints(
        in_file, up, front, tuple(name for name, found in zip(files, people, strict=True) if found is not None)
    )


def report_on(
    hints: Hints, places: Mapping[str, Float[np.ndarray, "3"]], rest_from_file: Float[np.ndarray, "4 4"]
) -> dict[str, Any]:
    """Report the pictures, and how far the joints are from where the keypoints have them, centimetres.

    `places` holds the joints in metres in the rest frame.
    """
    off = {}
    for name, pin in hints.pins.items():
        if name in places:
            there = rest_from_file[:3, :3] @ pin.place + rest_from_file[:3, 3]
            off[name] = round(100 * float(np.linalg.norm(places[name] - there)), 1)
    return {"pictures": list(hints.views), "off_cm": off}


def _files(path: Path) -> tuple[dict[str, Path], Path]:
    """Keypoint files by picture, and their folder."""
    expected = f"files named after the pictures, such as front{_SUFFIX}, were expected"
    if path.is_file():
        if not path.name.endswith(_SUFFIX):
            raise InputError(f"{path} has a name that tells no picture; {expected}.")
        files = {path.name.removesuffix(_SUFFIX): path}
        folder = path.parent
    elif path.is_dir():
        found = {name: path / f"{name}{_SUFFIX}" for name in VIEWS}
        files, folder = {name: file for name, file in found.items() if file.is_file()}, path
    else:
        raise InputError(f"{path} does not exist; a folder of keypoints beside {CAMERAS_FILE} was expected.")
    if not files:
        raise InputError(f"{path} holds no keypoints; {expected}.")
    return files, folder


def _cameras(path: Path, names: tuple[str, ...], scale: float) -> Cameras:
    if not path.is_file():
        raise InputError(f"{path} does not exist; keypoints belong beside the {CAMERAS_FILE} that --pictures wrote.")
    try:
        return read_cameras(path, names, 1, metres_per_unit=scale)
    except InputError as error:
        raise InputError(f"{str(error).rstrip('.')}: use {path} as --pictures wrote it for this mesh.") from None


def _person(file: Path, size: tuple[int, int]) -> np.ndarray | None:
    try:
        return best_person(read_people(file, size=size))
    except InputError as error:
        raise InputError(f"{str(error).rstrip('.')}.") from None


def _check_inside(file: Path, name: str, points: np.ndarray, size: tuple[int, int]) -> None:
    sure = points[points[:, 2] >= UNSURE, :2]
    border = _OUTSIDE * np.array(size)
    if len(sure) and (np.any(sure < -border) or np.any(sure > np.array(size) + border)):
        worst = sure[np.argmax(np.abs(sure - np.array(size) / 2).max(axis=1))]
        raise InputError(
            f"{file} has a point at {worst[0]:.0f}, {worst[1]:.0f}, outside {name}.png of {size[0]}x{size[1]} pixels; "
            f"{_AGAIN}."
        )


def _check_on_mesh(seen: Seen, files: tuple[Path, ...]) -> None:
    for camera, file in enumerate(files):
        misses = [crossing.miss for (of, _), crossing in seen.crossings.items() if of == camera]
        beside = sum(miss > _BESIDE for miss in misses)
        if 2 * beside > len(misses):
            raise InputError(f"{file} has {beside} of {len(misses)} joints beside the person; {_AGAIN}.")


def _directions(pins: dict[str, Pin]) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Up along the trunk, and front at right angles to it and to the lines from right to left."""
    top = _middle(pins, "shoulder")
    low = _middle(pins, "hip")
    across = [
        pins[f"l_{joint}"].place - pins[f"r_{joint}"].place
        for joint in ("shoulder", "hip")
        if f"l_{joint}" in pins and f"r_{joint}" in pins
    ]
    if top is None or low is None or not across:
        return None, None
    up = unit(top - low)
    left = np.sum([unit(vector) for vector in across], axis=0)
    front = np.cross(unit(left - (left @ up) * up), up)
    return up, unit(front)


def _middle(pins: dict[str, Pin], joint: str) -> np.ndarray | None:
    both = [pins[f"{side}_{joint}"].place for side in "lr" if f"{side}_{joint}" in pins]
    if len(both) == 2:
        return 0.5 * (both[0] + both[1])
    return pins[f"mid_{joint}"].place if f"mid_{joint}" in pins else None


def _listed(files: dict[str, Path]) -> str:
    return ", ".join(f"{name}.png" for name in files)
