"""What a scan looks at: pictures of a standing person, their cameras and masks, given or found."""

import tempfile
from pathlib import Path
from typing import NamedTuple

import cv2
import jax
import numpy as np
from jaxtyping import Bool, Float, UInt8

from jaxmocap._files import is_clutter
from jaxmocap._results import InputError
from jaxmocap.calibration import PHONE_FOCAL, calibrate_pictures
from jaxmocap.camera import Cameras, look_at_point, read_picture_cameras, world_from_upright
from jaxmocap.capture import Undistortion
from jaxmocap.geometry import camera_centres
from jaxmocap.rigging import check_height
from jaxmocap.scan import Views, person_place

from ._detect import Report, Say
from ._scan_frames import LONGEST, frames_of_walk
from ._scan_masks import find_outlines

_COLOURED = 1600  # pixels of the longer side of pictures that colours are taken from
PICTURES = (".jpg", ".jpeg", ".png")
WIDEST_GAP = 110.0
"""Degrees around the person without a picture, from which on there is no scan: what no outline cuts stays."""


def read_views(
    pictures: str | Path,
    cameras: str | Path | None = None,
    masks: str | Path | None = None,
    height: float | None = None,
    *,
    focal: float | None = None,
    weights: str | Path | None = None,
    seed: int = 0,
    say: Say = lambda sentence: None,
    progress: Report = lambda stage, done, total: None,
) -> tuple[tuple[str, ...], Views]:
    """Read the views and their names, as `scan` says, and find cameras and masks where none are given."""
    pictures = Path(pictures)
    filmed = pictures.is_file()
    _refuse_options(pictures, cameras, masks, height, focal)
    with tempfile.TemporaryDirectory() as place:
        if filmed:
            files, guess, scale = frames_of_walk(pictures, Path(place), progress=progress)
            recorded = (0, 0)  # which masks have, and they go with pictures alone
        else:
            longest = LONGEST if cameras is None else None
            prepared = [_in_place(file, Path(place), cameras is None, longest) for file in pictures_in(pictures)]
            _refuse_sizes(pictures, {one.size for one in prepared})
            files, guess, scale = [one.file for one in prepared], None, prepared[0].scale
            recorded = prepared[0].size
        focal = scale * focal if focal is not None else None
        images = {file: _read(file) for file in files}
        size = next((image.shape[1], image.shape[0]) for image in images.values())
        if cameras is None:
            guess = focal or guess or PHONE_FOCAL * max(size)
            options = {"guess": guess, "focal": focal, "in_order": filmed, "seed": seed, "progress": progress}
            placed = calibrate_pictures(files, size, **options)
            if placed.left_out:
                say(f"{', '.join(placed.left_out)} could not be placed among the others, and are left out.")
            known, files = placed.cameras, [file for file in files if file.name in placed.names]
            _refuse_open_lap(pictures, known)
        else:
            names = [file.name for file in files]
            known = read_picture_cameras(Path(cameras), names, size, any_scale=height is not None)
        if masks is None:
            assert height is not None
            shown, known = find_outlines(files, known, height, jax.random.key(seed), weights, say, progress)
        lenses = [
            Undistortion(np.asarray(k), np.asarray(d), one)
            for k, d, one in zip(known.intrinsics, known.distortion, known.sizes, strict=True)
        ]
        coloured = np.stack([_coloured(file, lens) for lens, file in zip(lenses, files, strict=True)])
    grey = np.stack([lens.image(images[file]) for lens, file in zip(lenses, files, strict=True)])
    if masks is not None:
        drawn = [_mask(Path(masks), file, recorded, size) for file in files]
        shown = np.stack([lens.mask(mask) for lens, mask in zip(lenses, drawn, strict=True)])
    views = Views(grey, shown, np.asarray(known.intrinsics), np.array(known.cam_from_world[:, 0]), coloured)
    if masks is not None and height is not None:
        views.cam_from_world[:, :3, 3] *= height / person_place(views)[1]
    return tuple(file.stem for file in files), views


def widest_gap(cam_from_world: Float[np.ndarray, "view 4 4"]) -> float:
    """Measure the widest gap between the directions of cameras around what they look at, degrees."""
    poses = np.asarray(cam_from_world, np.float64)
    x, _, z = ((camera_centres(poses) - look_at_point(poses)) @ world_from_upright(poses)).T
    angles = np.sort(np.degrees(np.arctan2(z, x)))
    return float(np.max(np.diff(np.append(angles, angles[0] + 360))))


def _refuse_open_lap(pictures: Path, known: Cameras) -> None:
    gap = widest_gap(np.asarray(known.cam_from_world)[:, 0])
    if gap > WIDEST_GAP:
        raise InputError(
            f"{pictures} leaves {gap:.0f} degrees around the person unseen, {WIDEST_GAP:.0f} at most are allowed: go "
            "once all around, at the same distance."
        )


def _refuse_options(
    pictures: Path, cameras: str | Path | None, masks: str | Path | None, height: float | None, focal: float | None
) -> None:
    if height is not None:
        check_height(height)
    elif masks is None:
        raise InputError("masks are found around a body of the person's height; say it with --height, or give --masks.")
    elif cameras is None:
        raise InputError("pictures alone do not tell how large anything is: say how tall the person is with --height.")
    if pictures.is_file() and (cameras is not None or masks is not None):
        given = "--cameras" if cameras is not None else "--masks"
        raise InputError(f"{given} goes with a folder of pictures, and {pictures} is a video; leave it out.")
    if focal is not None and cameras is not None:
        raise InputError("--focal is for pictures without cameras; leave it or --cameras out.")
    if focal is not None and not 10 < focal < 1e5:
        raise InputError(
            f"--focal is {focal:g}; a focal length in pixels was expected, about the width of the pictures."
        )


def pictures_in(folder: Path) -> list[Path]:
    """List the pictures of a folder. Raises `InputError` without any, and for two of one name."""
    if not folder.is_dir():
        raise InputError(
            f"{folder} does not exist; give a video, or the folder of the pictures ({', '.join(PICTURES)})."
        )
    files = sorted(file for file in folder.iterdir() if file.suffix.lower() in PICTURES and not is_clutter(file.name))
    if not files:
        raise InputError(f"{folder} holds no pictures ({', '.join(PICTURES)}).")
    stems = [file.stem for file in files]
    for stem in stems:
        if stems.count(stem) > 1:
            raise InputError(f"{folder} holds {stem} as more than one kind of file; keep one.")
    return files


class _Picture(NamedTuple):
    """A picture that any program reads alike: its file, how large it was, and by how much it was made smaller."""

    file: Path
    size: tuple[int, int]
    scale: float


def _in_place(file: Path, place: Path, upright: bool, longest: int | None) -> _Picture:
    """Give a picture that its metadata turns as a copy: upright, or as it is stored, which is how others' cameras see
    it; and one whose longer side has more than `longest` pixels as a smaller one. Else it is the picture itself."""
    stored, turned = _read(file, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION), _read(file, cv2.IMREAD_COLOR)
    pixels = turned if upright else stored
    height, width = pixels.shape[:2]
    scale = min(1.0, longest / max(width, height)) if longest is not None else 1.0
    if scale == 1.0 and np.array_equal(stored, turned):
        return _Picture(file, (width, height), 1.0)
    if scale < 1.0:
        pixels = cv2.resize(pixels, (round(scale * width), round(scale * height)), interpolation=cv2.INTER_AREA)
    quality = [] if file.suffix.lower() == ".png" else [cv2.IMWRITE_JPEG_QUALITY, 98]
    encoded = cv2.imencode(file.suffix, pixels, quality)[1]
    (place / file.name).write_bytes(encoded.tobytes())
    return _Picture(place / file.name, (width, height), scale)


def _read(
    file: Path, flags: int = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION
) -> UInt8[np.ndarray, "height width *channel"]:
    content = np.frombuffer(file.read_bytes(), np.uint8)
    image = cv2.imdecode(content, flags) if len(content) else None
    if image is None:
        raise InputError(f"{file} cannot be read as a picture; export it again as JPEG or PNG.")
    return image


def _coloured(file: Path, lens: Undistortion) -> UInt8[np.ndarray, "height width 3"]:
    """Read a picture in colour, RGB, undistorted and small enough for the colours of a few thousand vertices."""
    image = lens.image(_read(file, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION))
    shrink = min(1.0, _COLOURED / max(image.shape))
    size = [max(1, round(shrink * side)) for side in image.shape[1::-1]]
    return cv2.cvtColor(cv2.resize(image, size, interpolation=cv2.INTER_AREA), cv2.COLOR_BGR2RGB)


def _mask(
    folder: Path, picture: Path, recorded: tuple[int, int], size: tuple[int, int]
) -> Bool[np.ndarray, "height width"]:
    """Read a mask of the size of a recorded picture, and make it `size`."""
    file = folder / f"{picture.stem}.png"
    if not file.is_file():
        raise InputError(f"{picture.name} has no mask; expected {file}, white where the person is.")
    mask = _read(file) > 127
    if mask.shape != recorded[::-1]:
        raise InputError(
            f"{file} is {mask.shape[1]}x{mask.shape[0]} pixels, but {picture.name} is {recorded[0]}x{recorded[1]}; "
            "masks have the size of their pictures."
        )
    if not mask.any():
        raise InputError(f"{file} is empty: it shows nobody; draw it again or take the picture out.")
    return mask if size == recorded else cv2.resize(255 * mask.astype(np.uint8), size) > 127


def _refuse_sizes(pictures: Path, sizes: set[tuple[int, int]]) -> None:
    if len(sizes) > 1:
        found = ", ".join(f"{width}x{height}" for width, height in sorted(sizes))
        raise InputError(f"the pictures in {pictures} have {len(sizes)} sizes ({found}); give those of one.")
