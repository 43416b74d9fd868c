"""The views of a scan as a folder: pictures, masks to look at and to correct, and what is known of both."""

import hashlib
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, UInt8
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, ValidationError

from jaxmocap._files import atomic_folder, write_bytes, write_json
from jaxmocap._results import InputError
from jaxmocap.scan import Views
from jaxmocap.viewers import draw_mask

from ._scan_length import MeasuredLength

_RECORD = "views.json"
"""File by which a folder is known as one of these."""

_COLOURED = 1600  # pixels of the longer side of pictures that colours are taken from

_Row = Annotated[list[FiniteFloat], Field(min_length=3, max_length=3)]
_Row4 = Annotated[list[FiniteFloat], Field(min_length=4, max_length=4)]


class ScanViews(NamedTuple):
    """What a scan looks at.

    Attributes:
        names: of the views.
        views: pictures, masks and cameras in metres.
        filmed: whether they follow each other in time.
        height: of the person, metres, where that tells the scale.
        masks: where each comes from and how sure it is, as `person_record` says; the source is "corrected" where
            somebody changed it in a folder of views.
        length: that tells the scale, where one does.
    """

    names: tuple[str, ...]
    views: Views
    filmed: bool
    height: float | None
    masks: tuple[dict[str, Any], ...]
    length: MeasuredLength | None = None

    @property
    def scale(self) -> dict[str, Any]:
        """What told the scale, as a report holds it."""
        if self.length is not None:
            return {"from": "known length", **self.length._asdict()}
        return {"from": "cameras" if self.height is None else "height"}


class _View(BaseModel):
    model_config = ConfigDict(frozen=True)
    mask: dict[str, str | FiniteFloat]
    mask_hash: str
    intrinsics: Annotated[list[_Row], Field(min_length=3, max_length=3)]
    cam_from_world: Annotated[list[_Row4], Field(min_length=4, max_length=4)]


class _Record(BaseModel):
    model_config = ConfigDict(frozen=True)
    filmed: bool
    height_m: FiniteFloat | None
    known_length: MeasuredLength | None = None
    views: dict[str, _View]


def write_views(folder: Path, shown: ScanViews, images: Iterable[UInt8[np.ndarray, "height width 3"]]) -> None:
    """Write a new folder of views: `pictures` without distortion, `masks`, `overlays` of both, and `views.json`.

    `images` are the pictures, BGR, which are not held at once.
    """
    with atomic_folder(folder) as partial:
        for part in ("pictures", "masks", "overlays"):
            (partial / part).mkdir()
        for name, image, mask in zip(shown.names, images, shown.views.masks, strict=True):
            drawn = {"pictures": image, "masks": 255 * mask.astype(np.uint8), "overlays": draw_mask(image, mask)}
            for part, pixels in drawn.items():
                write_bytes(partial / part / f"{name}.png", cv2.imencode(".png", pixels)[1].tobytes())
        cameras = zip(shown.masks, shown.views.masks, shown.views.intrinsics, shown.views.cam_from_world, strict=True)
        views = [
            {"mask": record, "mask_hash": _hash(mask), "intrinsics": intrinsics, "cam_from_world": pose}
            for record, mask, intrinsics, pose in cameras
        ]
        record = {
            "filmed": shown.filmed,
            "height_m": shown.height,
            "known_length": None if shown.length is None else shown.length._asdict(),
            "views": dict(zip(shown.names, views, strict=True)),
        }
        write_json(partial / _RECORD, record)


def read_folder(folder: Path) -> tuple[ScanViews, Iterator[UInt8[np.ndarray, "height width 3"]]]:
    """Read a folder of views, masks as they are now; a view whose picture was deleted is left out.

    Also gives the pictures as `write_views` takes them. Raises `InputError` where anything but masks is not as it was
    written.
    """
    record = _read_record(folder / _RECORD)
    known = {name: view for name, view in record.views.items() if _file(folder, "pictures", name).is_file()}
    if not known:
        raise InputError(f"{folder / 'pictures'} holds none of the pictures that {_RECORD} names; scan again.")
    grey, pictures, masks = [], [], []
    images = lambda: (read_picture(_file(folder, "pictures", name), cv2.IMREAD_COLOR) for name in known)  # noqa: E731
    for name, image in zip(known, images(), strict=True):
        size = (image.shape[1], image.shape[0])
        masks.append(read_mask(_file(folder, "masks", name), f"{name}.png", size))
        for many, one in zip((grey, pictures), grey_and_small(image), strict=True):
            many.append(one)
    refuse_sizes(folder / "pictures", {(one.shape[1], one.shape[0]) for one in grey})
    intrinsics = np.array([view.intrinsics for view in known.values()], np.float32)
    poses = np.array([view.cam_from_world for view in known.values()], np.float32)
    origins = tuple(
        view.mask if _hash(mask) == view.mask_hash else {"source": "corrected"}
        for mask, view in zip(masks, known.values(), strict=True)
    )
    views = Views(np.stack(grey), np.stack(masks), intrinsics, poses, np.stack(pictures))
    return ScanViews(tuple(known), views, record.filmed, record.height_m, origins, record.known_length), images()


def grey_and_small(
    image: UInt8[np.ndarray, "height width 3"],
) -> tuple[UInt8[np.ndarray, "height width"], UInt8[np.ndarray, "h w 3"]]:
    """Turn a picture, BGR, into grey, and into RGB small enough for the colours of a few thousand vertices."""
    shrink = min(1.0, _COLOURED / max(image.shape))
    size = [max(1, round(shrink * side)) for side in image.shape[1::-1]]
    small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    return cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), cv2.cvtColor(small, cv2.COLOR_BGR2RGB)


def read_picture(
    file: Path, flags: int = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION
) -> UInt8[np.ndarray, "height width *channel"]:
    """Read a picture as it is stored. Raises `InputError` for a file that is none."""
    content = np.frombuffer(file.read_bytes(), np.uint8)
    image = cv2.imdecode(content, flags) if len(content) else None
    if image is None:
        raise InputError(f"{file} cannot be read as a picture; export it again as JPEG or PNG.")
    return image


def read_mask(file: Path, picture: str, size: tuple[int, int]) -> Bool[np.ndarray, "height width"]:
    """Read the mask of a picture of this size. Raises `InputError` where it is missing, empty or of another size."""
    if not file.is_file():
        raise InputError(f"{picture} has no mask; expected {file}, white where the person is.")
    mask = read_picture(file) > 127
    if mask.shape != size[::-1]:
        raise InputError(
            f"{file} is {mask.shape[1]}x{mask.shape[0]} pixels, but {picture} is {size[0]}x{size[1]}; "
            "masks have the size of their pictures."
        )
    if not mask.any():
        raise InputError(f"{file} is empty: it shows nobody; draw it again or take the picture out.")
    return mask


def refuse_sizes(pictures: Path, sizes: set[tuple[int, int]]) -> None:
    """Raise `InputError` where pictures are not of one size."""
    if len(sizes) > 1:
        found = ", ".join(f"{width}x{height}" for width, height in sorted(sizes))
        raise InputError(f"the pictures in {pictures} have {len(sizes)} sizes ({found}); give those of one.")


def is_views_folder(path: Path) -> bool:
    """Tell whether these are the views of a scan, with cameras and masks."""
    return (path / _RECORD).is_file()


def _read_record(file: Path) -> _Record:
    try:
        record = _Record.model_validate_json(file.read_bytes())
    except ValidationError as error:
        first = error.errors()[0]
        what = ": ".join([*map(str, first["loc"]), first["msg"]])
        raise InputError(f"{file} is not what a scan wrote: {what}; scan the video or the pictures again.") from error
    for name in record.views:
        if Path(name).name != name:
            raise InputError(f"{file} names a view {name!r}, a path; names of pictures in {file.parent} were expected.")
    return record


def _file(folder: Path, part: str, name: str) -> Path:
    return folder / part / f"{name}.png"


def _hash(mask: Bool[np.ndarray, "height width"]) -> str:
    return hashlib.blake2b(np.packbits(mask).tobytes(), digest_size=16).hexdigest()
