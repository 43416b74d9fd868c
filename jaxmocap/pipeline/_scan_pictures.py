"""The pictures that a scan is given as files: which there are, which way up they are read, and their masks."""

from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool

from jaxmocap._files import is_clutter
from jaxmocap._results import InputError
from jaxmocap.scan import refuse_few_views

from ._scan_folder import read_mask, read_picture

PICTURES = (".jpg", ".jpeg", ".png")


def pictures_in(folder: Path) -> list[Path]:
    """List the pictures of a folder. Raises `InputError` for too few to scan somebody, and for two of one name."""
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
    refuse_few_views(len(files), str(folder))
    return files


class Picture(NamedTuple):
    """A picture that any program reads alike: its file, how large it was, and by how much it was made smaller."""

    file: Path
    size: tuple[int, int]
    scale: float


def in_place(file: Path, place: Path, upright: bool, longest: int | None) -> Picture:
    """Give a picture that its metadata turns as a copy: upright, or as it is stored, which is how others' cameras see
    it; and one whose longer side has more than `longest` pixels as a smaller one. Else it is the picture itself."""
    stored, turned = (
        read_picture(file, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION),
        read_picture(file, cv2.IMREAD_COLOR),
    )
    pixels = turned if upright else stored
    height, width = pixels.shape[:2]
    scale = min(1.0, longest / max(width, height)) if longest is not None else 1.0
    if scale == 1.0 and np.array_equal(stored, turned):
        return Picture(file, (width, height), 1.0)
    if scale < 1.0:
        pixels = cv2.resize(pixels, (round(scale * width), round(scale * height)), interpolation=cv2.INTER_AREA)
    quality = [] if file.suffix.lower() == ".png" else [cv2.IMWRITE_JPEG_QUALITY, 98]
    encoded = cv2.imencode(file.suffix, pixels, quality)[1]
    (place / file.name).write_bytes(encoded.tobytes())
    return Picture(place / file.name, (width, height), scale)


def mask_of(
    folder: Path, picture: Path, recorded: tuple[int, int], size: tuple[int, int]
) -> Bool[np.ndarray, "height width"]:
    """Read a mask of the size of a recorded picture, and make it `size`."""
    mask = read_mask(folder / f"{picture.stem}.png", picture.name, recorded)
    return mask if size == recorded else cv2.resize(255 * mask.astype(np.uint8), size) > 127
