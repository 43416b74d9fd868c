"""What a scan looks at: pictures of a standing person, their cameras and masks, given or found."""

import tempfile
from collections.abc import Iterator
from pathlib import Path

import cv2
import jax
import numpy as np
from jaxtyping import Float, UInt8

from jaxmocap._results import InputError
from jaxmocap._types import Report, Say
from jaxmocap.calibration import PHONE_FOCAL, calibrate_pictures
from jaxmocap.camera import Cameras, look_at_point, read_picture_cameras, world_from_upright
from jaxmocap.capture import Undistortion
from jaxmocap.geometry import camera_centres
from jaxmocap.rigging import check_height
from jaxmocap.scan import Views, person_place

from ._defaults import person_record
from ._scan_folder import (
    ScanViews,
    grey_and_small,
    is_views_folder,
    read_folder,
    read_picture,
    refuse_sizes,
    write_views,
)
from ._scan_frames import LONGEST, frames_of_walk
from ._scan_length import KnownLength, refuse_giant
from ._scan_masks import find_outlines
from ._scan_pictures import in_place, mask_of, pictures_in

WIDEST_GAP = 110.0
"""Degrees around the person without a picture, from which on there is no scan: what no outline cuts stays."""

ASSUMED = 1.7
"""Metres of the body around which outlines are looked for where a known length tells the scale."""


def read_views(
    pictures: str | Path,
    cameras: str | Path | None = None,
    masks: str | Path | None = None,
    height: float | None = None,
    *,
    length: KnownLength | None = None,
    keep_views: str | Path | None = None,
    focal: float | None = None,
    weights: str | Path | None = None,
    seed: int = 0,
    say: Say = lambda sentence: None,
    progress: Report = lambda stage, done, total: None,
) -> ScanViews:
    """Read the views, as `scan` says, and find cameras and masks where none are given; write them to `keep_views`."""
    pictures = Path(pictures)
    if height is not None and length is not None:
        raise InputError("--height and --known-length both tell how large the person is; leave one of them out.")
    if keep_views is not None and Path(keep_views).exists() and not _is_empty_folder(Path(keep_views)):
        raise InputError(f"{keep_views} exists already; choose a new or an empty folder with --keep-views.")
    with tempfile.TemporaryDirectory() as place:
        if is_views_folder(pictures):
            _refuse_beside_folder(pictures, cameras, masks, focal)
            shown, images = read_folder(pictures)
            shown = shown if length is None else _by_length(shown, length, pictures / "pictures")
        else:
            _refuse_options(pictures, cameras, masks, height, length, focal)
            told = {"focal": focal, "weights": weights, "seed": seed, "say": say, "progress": progress}
            shown, images = _look(pictures, Path(place), cameras, masks, height, length, **told)
        if shown.length is not None:
            refuse_giant(shown.length, person_place(shown.views)[1])
            if height is not None:
                raise InputError(f"a known length tells the scale of the views in {pictures}; leave --height out.")
        if height is not None and shown.height is None:
            shown.views.cam_from_world[:, :3, 3] *= height / person_place(shown.views)[1]
            shown = shown._replace(height=height)
        if height is not None and height != shown.height:
            raise InputError(
                f"{pictures} is of somebody {shown.height} m tall, and the height that is given is {height:g} m; scan "
                "the video or the pictures again for another height."
            )
        if keep_views is not None:
            write_views(Path(keep_views), shown, images)
    return shown


def _look(
    pictures: Path,
    place: Path,
    cameras: str | Path | None,
    masks: str | Path | None,
    height: float | None,
    length: KnownLength | None,
    *,
    focal: float | None,
    weights: str | Path | None,
    seed: int,
    say: Say,
    progress: Report,
) -> tuple[ScanViews, Iterator[UInt8[np.ndarray, "height width 3"]]]:
    """Look at pictures or a video; also give the pictures, BGR, without distortion."""
    filmed = pictures.is_file()
    if filmed:
        files, guess, scale = frames_of_walk(pictures, place, progress=progress)
        recorded = (0, 0)  # which masks have, and they go with pictures alone
    else:
        longest = LONGEST if cameras is None else None
        prepared = [in_place(file, place, cameras is None, longest) for file in pictures_in(pictures)]
        refuse_sizes(pictures, {one.size for one in prepared})
        files, guess, scale = [one.file for one in prepared], None, prepared[0].scale
        recorded = prepared[0].size
    if length is not None:
        length.refuse_outside(pictures, [file.stem for file in files], recorded)
    focal = scale * focal if focal is not None else None
    first = read_picture(files[0])
    size = (first.shape[1], first.shape[0])
    if cameras is None:
        guess = focal or guess or PHONE_FOCAL * max(size)
        options = {"guess": guess, "focal": focal, "in_order": filmed, "seed": seed, "progress": progress}
        placed = calibrate_pictures(files, size, **options)
        if placed.left_out:
            say(f"{', '.join(placed.left_out)} could not be placed among the others, and are left out.")
        known, files = placed.cameras, [file for file in files if file.name in placed.names]
        _refuse_open_lap(pictures, known)
    else:
        any_scale = height is not None or length is not None
        known = read_picture_cameras(Path(cameras), [file.name for file in files], size, any_scale=any_scale)
    measured = None
    if length is not None:
        known, measured = length.scale([file.stem for file in files], known, recorded)
    outlines = None
    if masks is None:
        tall = ASSUMED if height is None else height
        outlines = find_outlines(files, known, tall, jax.random.key(seed), weights, say, progress)
        files = [files[view] for view in outlines.used]
        known = outlines.cameras if measured is None else known.only(outlines.used)
        if cameras is None:
            _refuse_open_lap(pictures, known)
    cameras_of = zip(known.intrinsics, known.distortion, known.sizes, strict=True)
    lenses = [Undistortion(np.asarray(k), np.asarray(d), one) for k, d, one in cameras_of]

    def images() -> Iterator[UInt8[np.ndarray, "height width 3"]]:
        for lens, file in zip(lenses, files, strict=True):
            yield lens.image(read_picture(file, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION))

    if outlines is not None:
        shown, origins = outlines.masks, tuple(person_record(one) for one in outlines.people)
    else:
        assert masks is not None
        drawn = [mask_of(Path(masks), file, recorded, size) for file in files]
        shown = np.stack([lens.mask(mask) for lens, mask in zip(lenses, drawn, strict=True)])
        height, origins = None, ({"source": "given"},) * len(files)  # nothing has told the scale by the height yet
    grey, coloured = map(np.stack, zip(*map(grey_and_small, images()), strict=True))
    views = Views(grey, shown, np.asarray(known.intrinsics), np.array(known.cam_from_world[:, 0]), coloured)
    return ScanViews(tuple(file.stem for file in files), views, filmed, height, origins, measured), images()


def _by_length(shown: ScanViews, length: KnownLength, pictures: Path) -> ScanViews:
    """Scale views that were kept to what a known length says, whatever told their scale before."""
    views, (high, wide) = shown.views, shown.views.masks.shape[1:]
    length.refuse_outside(pictures, shown.names, (wide, high))
    poses = jax.device_put(views.cam_from_world[:, None])
    lenses = jax.device_put(views.intrinsics), jax.device_put(np.zeros((len(poses), 5), np.float32))
    cameras = Cameras(shown.names, ((wide, high),) * len(poses), *lenses, poses)
    cameras, measured = length.scale(shown.names, cameras, (wide, high))
    views = views._replace(cam_from_world=np.array(cameras.cam_from_world[:, 0]))
    return shown._replace(views=views, height=None, length=measured)


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


def _refuse_beside_folder(
    pictures: Path, cameras: str | Path | None, masks: str | Path | None, focal: float | None
) -> None:
    for option, given in (("--cameras", cameras), ("--masks", masks), ("--focal", focal)):
        if given is not None:
            raise InputError(
                f"{pictures} holds the views of a scan, with cameras and masks; leave {option} out, and correct masks "
                f"in {pictures / 'masks'}."
            )


def _is_empty_folder(path: Path) -> bool:
    return path.is_dir() and not any(path.iterdir())


def _refuse_options(
    pictures: Path,
    cameras: str | Path | None,
    masks: str | Path | None,
    height: float | None,
    length: KnownLength | None,
    focal: float | None,
) -> None:
    if length is not None and pictures.is_file():
        raise InputError(
            f"--known-length is marked in pictures, and {pictures} is a video: scan it with --height METRES (a guess "
            "will do) and --keep-views DIR first, mark the length in DIR/pictures, then scan DIR with --known-length."
        )
    if height is not None:
        check_height(height)
    elif length is None and masks is None:
        raise InputError(
            "masks are found around a body of the person's height; say it with --height, or give --masks, or mark a "
            "--known-length in pictures."
        )
    elif length is None and cameras is None:
        raise InputError(
            "pictures alone do not tell how large anything is: say how tall the person is with --height, or mark a "
            "--known-length in them."
        )
    if pictures.is_file() and (cameras is not None or masks is not None):
        given = "--cameras" if cameras is not None else "--masks"
        raise InputError(f"{given} goes with a folder of pictures, and {pictures} is a video; leave it out.")
    if focal is not None and cameras is not None:
        raise InputError("--focal is for pictures without cameras; leave it or --cameras out.")
    if focal is not None and not 10 < focal < 1e5:
        raise InputError(
            f"--focal is {focal:g}; a focal length in pixels was expected, about the width of the pictures."
        )
