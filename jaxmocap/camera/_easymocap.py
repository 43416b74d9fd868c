"""EasyMocap's calibrations of static cameras: a folder with `intri.yml` and `extri.yml`.

The form is that of `write_camera` in EasyMocap's `easymocap/mytools/camera_utils.py`: a list `names`, and for a camera
`a` the matrices `K_a` (3 x 3) and `dist_a` (1 x 5) in the one file, with `H_a` and `W_a` where the size was known, and
`R_a` (Rodrigues, 3 x 1), `Rot_a` (3 x 3) and `T_a` (3 x 1), from the world to the camera, in the other. EasyMocap
undistorts with OpenCV, so principal points are in its convention. Lengths are in the capture's units; EasyMocap's are
metres.
"""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from jaxmocap._results import InputError

from ._file_storage import read_storage
from ._opencv_storage import ROTATION_SHAPES, TRANSLATION_SHAPES
from ._static_camera import (
    StaticCamera,
    WrittenCamera,
    check_names,
    five_coefficients,
    numbers,
    one_rotation,
    pinhole,
    pose,
    read_text,
    whole_size,
)

FILES = ("intri.yml", "extri.yml")
_COUNTS = tuple(shape for count in (4, 5, 8, 12, 14) for shape in ((1, count), (count, 1)))


def easymocap_files(folder: Path) -> tuple[Path, Path] | None:
    """Find the intrinsics and extrinsics of a folder; None if it has neither. Raises `InputError` if one is missing."""
    intrinsics, extrinsics = folder / FILES[0], folder / FILES[1]
    there = [file for file in (intrinsics, extrinsics) if file.is_file()]
    if len(there) == 1:
        raise InputError(
            f"{folder.name}/ has {there[0].name} but no {FILES[1 - FILES.index(there[0].name)]}; an EasyMocap "
            "calibration is both files"
        )
    return (intrinsics, extrinsics) if there else None


def _names(document: dict[str, Any], label: str) -> list[str]:
    names = document.get("names")
    if not isinstance(names, list) or not names:
        raise InputError(f"{label} has no list of names; expected EasyMocap's names, K_<name>, R_<name> and so on")
    return [str(name) for name in names]


def _rename(document: dict[str, Any], name: str) -> dict[str, Any]:
    """Rename the entries `<key>_<name>` of one camera to `<key>`."""
    return {key.removesuffix(f"_{name}"): value for key, value in document.items() if key.endswith(f"_{name}")}


def _camera(inside: dict[str, Any], outside: dict[str, Any], where: tuple[str, str]) -> StaticCamera:
    if "K" not in inside and "R" in inside:
        raise InputError(f"{where[0]} has R and no K; expected intrinsics: are {FILES[0]} and {FILES[1]} swapped?")
    size = None
    if "W" in inside or "H" in inside:
        size = whole_size(np.array([numbers(inside, key, where[0], ((),)) for key in "WH"]), where[0], "W and H")
    distortion = np.zeros(5)
    if "dist" in inside or "D" in inside:
        distortion = numbers(inside, ("dist", "D"), where[0], _COUNTS)
    keys = [key for key in ("R", "Rot") if key in outside] or ["R"]
    rotation = one_rotation({key: numbers(outside, key, where[1], ROTATION_SHAPES) for key in keys}, where[1])
    return StaticCamera(
        size,
        pinhole(numbers(inside, "K", where[0], ((3, 3),)), where[0], "K"),
        five_coefficients(distortion, where[0], "dist"),
        pose(rotation, numbers(outside, "T", where[1], TRANSLATION_SHAPES)),
    )


def read_easymocap(files: tuple[Path, Path], names: tuple[str, ...]) -> list[StaticCamera]:
    """Read the cameras called `names`, in that order."""
    labels = [f"{file.parent.name}/{file.name}" for file in files]
    documents = [read_storage(read_text(file, label), label) for file, label in zip(files, labels, strict=True)]
    for document, label in zip(documents, labels, strict=True):
        check_names(names, _names(document, label), label)
    cameras = []
    for name in names:
        where = f"{labels[0]} camera {name}", f"{labels[1]} camera {name}"
        cameras.append(_camera(_rename(documents[0], name), _rename(documents[1], name), where))
    return cameras


def _matrix(key: str, value: np.ndarray) -> Iterator[str]:
    yield f"{key}: !!opencv-matrix"
    yield f"  rows: {value.shape[0]}"
    yield f"  cols: {value.shape[1]}"
    yield "  dt: d"
    yield f"  data: [{', '.join(map(repr, value.ravel().tolist()))}]"


def easymocap_texts(cameras: list[WrittenCamera]) -> dict[str, str]:
    """Write one text per file name. Raises `InputError` for a name that the form cannot hold."""
    from scipy.spatial.transform import Rotation

    for camera in cameras:
        if not re.fullmatch(r"[A-Za-z0-9_\-]+", camera.name):
            raise InputError(
                f"camera {camera.name!r} cannot be written for EasyMocap, whose names are letters, digits, - and _ "
                "only: give it another name"
            )
    head = ["%YAML:1.0", "---", "names:", *(f'  - "{camera.name}"' for camera in cameras)]
    inside, outside = list(head), list(head)
    for camera in cameras:
        inside += [
            *_matrix(f"K_{camera.name}", camera.intrinsics),
            *_matrix(f"dist_{camera.name}", camera.distortion[None]),
        ]
        inside += [f"H_{camera.name}: {camera.size[1]}", f"W_{camera.name}: {camera.size[0]}"]
        vector = Rotation.from_matrix(camera.rotation).as_rotvec()
        outside += [*_matrix(f"R_{camera.name}", vector[:, None]), *_matrix(f"Rot_{camera.name}", camera.rotation)]
        outside += _matrix(f"T_{camera.name}", camera.translation[:, None])
    return {FILES[0]: "\n".join([*inside, ""]), FILES[1]: "\n".join([*outside, ""])}
