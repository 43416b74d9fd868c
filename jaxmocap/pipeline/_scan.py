"""`scan`: pictures of a standing person, with cameras and masks, become an actor."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import jax
import numpy as np
from jaxtyping import Bool, UInt8

from jaxmocap._files import atomic_path
from jaxmocap._results import InputError
from jaxmocap.camera import read_picture_cameras
from jaxmocap.capture import Undistortion
from jaxmocap.rigging import RiggedMesh, rig
from jaxmocap.scan import Scan, Views, person_place, reconstruct

from ._scan_masks import find_outlines

PICTURES = (".jpg", ".jpeg", ".png")
POOR = 0.85
"""Overlap of the surface's silhouette and a mask below which somebody had better look at the mask."""


@dataclass(frozen=True)
class ScannedActor:
    """An actor made of pictures.

    Attributes:
        scan: the surface in the cameras' world, in metres.
        rigged: the actor that was made of it.
        report: what was found, as JSON knows it: `views`, `left_out`, `overlap` by view, `triangles`, and what `rig`
            reports.
    """

    scan: Scan
    rigged: RiggedMesh
    report: dict[str, Any]


def read_views(
    pictures: str | Path,
    cameras: str | Path,
    masks: str | Path | None = None,
    height: float | None = None,
    say: Callable[[str], None] | None = None,
) -> tuple[tuple[str, ...], Views]:
    """Read the views and their names, as `scan` says, and find masks where none are given."""
    if masks is None and height is None:
        raise InputError("masks are found around a body of the person's height; say it with --height, or give --masks.")
    files = _pictures(Path(pictures))
    images = [_read(file) for file in files]
    sizes = {(image.shape[1], image.shape[0]) for image in images}
    if len(sizes) > 1:
        raise InputError(f"the pictures in {pictures} have {len(sizes)} sizes ({_sizes(sizes)}); give pictures of one.")
    names = [file.name for file in files]
    scaled = height is not None and masks is not None
    known = read_picture_cameras(Path(cameras), names, next(iter(sizes)), any_scale=scaled)
    lenses = [
        Undistortion(np.asarray(k), np.asarray(d), size)
        for k, d, size in zip(known.intrinsics, known.distortion, known.sizes, strict=True)
    ]
    grey = np.stack([lens.image(image) for lens, image in zip(lenses, images, strict=True)])
    if masks is None:
        assert height is not None
        shown = find_outlines(files, known, height, jax.random.key(0), say)
    else:
        drawn = [_mask(Path(masks), file, image.shape) for file, image in zip(files, images, strict=True)]
        shown = np.stack([lens.mask(mask) for lens, mask in zip(lenses, drawn, strict=True)])
    views = Views(grey, shown, np.asarray(known.intrinsics), np.array(known.cam_from_world[:, 0]))
    if scaled:
        assert height is not None
        views.cam_from_world[:, :3, 3] *= height / person_place(views)[1]
    return tuple(file.stem for file in files), views


def scan(
    pictures: str | Path,
    out: str | Path | None = None,
    *,
    cameras: str | Path,
    masks: str | Path | None = None,
    height: float | None = None,
    num_faces: int = 5000,
    say: Callable[[str], None] | None = None,
) -> ScannedActor:
    """Scan a person who stands still, from pictures all around, and rig what comes out.

    `pictures` is a folder of JPEG or PNG files of one size, all taken at once or while the person stood still.
    `cameras` is a COLMAP model whose images have the names of these files, or a static calibration of cameras with the
    files' names; `masks` a folder of PNG files with these names, white on the person. Without masks the person is
    detected (extra `detect`) and cut out around the built-in body of this `height` (`find_outlines`); then the cameras
    are in metres, about. With masks `height` in metres scales the cameras' world, which is in metres otherwise. Writes
    a GLB to `out`, if given, that `track --actor` takes. Raises `InputError` for files that are missing or do not fit,
    silhouettes with nothing in common, and where no standing person is found.
    """
    names, views = read_views(pictures, cameras, masks, height, say)
    found = reconstruct(views)
    rigged = rig(
        (found.vertices, found.faces),
        num_faces=num_faces,
        height=height,
        units=None if height is not None else "m",
        anew=True,
        name=Path(out).stem if out is not None else "scan",
    )
    left_out = [name for name, used in zip(names, found.used, strict=True) if not used]
    poor = [n for n, share in zip(names, found.overlap, strict=True) if share < POOR and n not in left_out]
    report = {
        "views": len(names),
        "left_out": left_out,
        "overlap": {name: round(float(share), 4) for name, share in zip(names, found.overlap, strict=True)},
        "scanned_triangles": len(found.faces),
        **rigged.report,
    }
    if say is not None and left_out:
        say(f"{', '.join(left_out)}: the mask lacks what the others show, and was left out; look at it.")
    if say is not None and poor:
        say(f"{', '.join(poor)}: the surface fits the mask badly; look at mask and camera.")
    if out is not None:
        Path(out).parent.mkdir(parents=True, exist_ok=True)
        with atomic_path(Path(out)) as temporary:
            rigged.character.save_glb(temporary)
    return ScannedActor(found, rigged, report)


def _pictures(folder: Path) -> list[Path]:
    if not folder.is_dir():
        raise InputError(f"{folder} is not a folder; give the folder that holds the pictures ({', '.join(PICTURES)}).")
    files = sorted(file for file in folder.iterdir() if file.suffix.lower() in PICTURES)
    if not files:
        raise InputError(f"{folder} holds no pictures ({', '.join(PICTURES)}).")
    stems = [file.stem for file in files]
    for stem in stems:
        if stems.count(stem) > 1:
            raise InputError(f"{folder} holds {stem} as more than one kind of file; keep one.")
    return files


def _read(file: Path) -> UInt8[np.ndarray, "height width"]:
    content = np.frombuffer(file.read_bytes(), np.uint8)
    grey_as_stored = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION  # as COLMAP sees it
    image = cv2.imdecode(content, grey_as_stored) if len(content) else None
    if image is None:
        raise InputError(f"{file} cannot be read as a picture; export it again as JPEG or PNG.")
    return image


def _mask(folder: Path, picture: Path, shape: tuple[int, int]) -> Bool[np.ndarray, "height width"]:
    file = folder / f"{picture.stem}.png"
    if not file.is_file():
        raise InputError(f"{picture.name} has no mask; expected {file}, white where the person is.")
    mask = _read(file) > 127
    if mask.shape != shape:
        raise InputError(
            f"{file} is {mask.shape[1]}x{mask.shape[0]} pixels, but {picture.name} is {shape[1]}x{shape[0]}; masks "
            "have the size of their pictures."
        )
    if not mask.any():
        raise InputError(f"{file} is empty: it shows nobody; draw it again or take the picture out.")
    return mask


def _sizes(sizes: set[tuple[int, int]]) -> str:
    return ", ".join(f"{width}x{height}" for width, height in sorted(sizes))
