"""The cameras of single pictures of something that stands still, found by all that the pictures show."""

import json
import shutil
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from jaxmocap._runtime import cores
from jaxmocap.camera import Cameras, read_picture_cameras

from ._child import run_worker
from ._footage import Report

NUM_FEATURES = 4000


class PlacedPictures(NamedTuple):
    """Pictures whose cameras were found.

    Attributes:
        names: of those that were placed, in order.
        cameras: one per picture that was placed, at whatever scale.
        left_out: names of the others.
    """

    names: tuple[str, ...]
    cameras: Cameras
    left_out: tuple[str, ...]


def calibrate_pictures(
    files: Sequence[Path],
    size: tuple[int, int],
    *,
    guess: float,
    focal: float | None = None,
    in_order: bool = False,
    seed: int = 0,
    progress: Report = lambda stage, done, total: None,
) -> PlacedPictures:
    """Find poses, focal length and radial distortion of the one camera that took these pictures, by structure from
    motion (Schoenberger and Frahm, CVPR 2016).

    Nothing may move between the pictures: the person counts like the background. `size` is that of the pictures,
    `guess` a first focal length in pixels; `focal` is one that is known and kept. `in_order` says that the pictures go
    once around, so that only near ones are matched. Raises `InputError` where fewer than half of them, or six, are
    placed.
    """
    plain = {f"{number:05d}{file.suffix}": file.name for number, file in enumerate(files)}  # lists have no blanks
    with tempfile.TemporaryDirectory(prefix="jaxmocap-") as temporary:
        work = Path(temporary)
        (work / "pictures").mkdir()
        for name, file in zip(plain, files, strict=True):
            shutil.copyfile(file, work / "pictures" / name)
        job = {"names": list(plain), "size": size, "guess": guess, "focal": focal, "in_order": in_order, "seed": seed}
        job |= {"threads": cores(), "num_features": NUM_FEATURES}
        (work / "job.json").write_text(json.dumps(job), encoding="utf-8")
        run_worker("pictures", work, progress)
        found = set(json.loads((work / "placed.json").read_text(encoding="utf-8")))
        placed = [name for name in plain if name in found]
        cameras = read_picture_cameras(work / "model", placed, size, any_scale=True)
    left_out = tuple(name for given, name in plain.items() if given not in found)
    return PlacedPictures(tuple(plain[name] for name in placed), cameras, left_out)
