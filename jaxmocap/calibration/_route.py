"""Which way cameras are found: by the background where they move, by the person where they stand still."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from jaxmocap._results import InputError
from jaxmocap.capture import Capture

from ._child import run_worker
from ._footage import Footage, Report
from ._static_job import known_lenses, refuse_without_person
from ._stillness import find_still_cameras


@dataclass(frozen=True)
class Route:
    """How cameras are found.

    Attributes:
        footage: what is calibrated.
        static: whether by the person.
        still: names of cameras that stand still.
        moving: names of cameras that move.
        matrices: what is known of the lenses beforehand, pixels.
        distortion: likewise, OpenCV's k1 k2 p1 p2 k3.
    """

    footage: Footage
    static: bool
    still: Sequence[str]
    moving: Sequence[str]
    matrices: Float[np.ndarray, "camera 3 3"]
    distortion: Float[np.ndarray, "camera 5"]

    def run(self, work: Path, report: Report) -> None:
        """Find the cameras in a child process. Raises `InputError` for footage that cannot be used."""
        try:
            run_worker("static" if self.static else "reconstruct", work, report)
        except InputError as error:
            if not (self.still and self.moving):
                raise
            raise InputError(
                f"{error} {_stand(self.still)} still and {_move(self.moving)}, which works only with a background that "
                "all see; film with all phones on tripods, or walk a step or two with each."
            ) from error


def choose_route(
    capture: Capture, footage: Footage, static: bool | None, intrinsics: Path | None, report: Report
) -> Route:
    """Look whether the cameras move, unless told whether they are `static`.

    Cameras that stand still and have no keypoints may be found by their background if their focal lengths are known.
    Raises `InputError` where cameras stand still and the person cannot tell them, and where they do not and have
    `intrinsics` or are said to be `static`.
    """
    found = find_still_cameras(footage, report)
    still = [name for name, one in zip(capture.camera_names, found, strict=True) if one == "still"]
    moving = [name for name, one in zip(capture.camera_names, found, strict=True) if one == "moving"]
    if static and moving:
        raise InputError(
            f"--static was given, but {_move(moving)}: leave it out, or film again with all phones on tripods"
        )
    by_person = len(still) == len(found) if static is None else static
    if by_person and footage.focal_known and intrinsics is None and static is None and capture.keypoints_folder is None:
        by_person = False
    if intrinsics is not None and not by_person:
        raise InputError(
            "--intrinsics is for cameras that all stand still; give the focal lengths of others with --focal"
        )
    if by_person and capture.keypoints_folder is None:
        refuse_without_person(capture, None)
    if intrinsics is not None:
        videos = tuple(replace(video, focal_known=True) for video in footage.videos)
        footage = replace(footage, videos=videos)
    return Route(footage, by_person, still, moving, *known_lenses(capture, footage, intrinsics))


def _stand(names: Sequence[str]) -> str:
    listed = ", ".join(f"'{name}'" for name in names)
    return f"Camera {listed} stands" if len(names) == 1 else f"Cameras {listed} stand"


def _move(names: Sequence[str]) -> str:
    listed = ", ".join(f"'{name}'" for name in names)
    return f"camera {listed} moves" if len(names) == 1 else f"cameras {listed} move"
