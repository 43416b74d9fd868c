"""Flashes: pictures much brighter or darker than those before and after them."""

from collections.abc import Iterator, Sequence

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from ._capture import Capture
from ._config import Finding

_BANDS = 16  # of rows, because a rolling shutter lights part of a frame, and blocks in each
_JUMP = 0.2  # of the logarithm of brightness; from frame to frame, moving cameras and people stay below 0.1
_BLACK = 4.0
_APART = 0.35  # the same, beyond what pictures around differ by: head cameras in a park reach 0.27, half a flash 0.41
_AROUND = ((-4, 4), (4, 8), (-8, -4))  # frames to two others, the first that there are: a flash lights three


def lit_apart(
    images: Sequence[UInt8[np.ndarray, "height width 3"]], before: Sequence[UInt8[np.ndarray, "height width 3"]]
) -> bool:
    """Tell whether, in any view, half of the blocks of some band have become much brighter or darker."""
    return any(_apart(_brightness(now), _brightness(then)) > _JUMP for now, then in zip(images, before, strict=True))


def lit_by_flash(capture: Capture, frame: int) -> bool:
    """Tell whether, in some view, a frame (a position) is in another light than both of two near it are.

    The light of these may differ, too, as where a camera turns to the sun: the frame's has to differ by more.
    """
    pairs = [[frame + step for step in steps] for steps in _AROUND]
    others = next((pair for pair in pairs if pair[0] >= 0 and pair[1] < capture.num_frames), None)
    if others is None:
        return False
    for camera in range(capture.num_cameras):
        light = {at: _brightness(capture.image(camera, at)) for at in sorted((frame, *others))}  # in order: quicker
        one, other = (light[at] for at in others)
        if min(_apart(light[frame], one), _apart(light[frame], other)) > _APART + _apart(one, other):
            return True
    return False


def check_selected_light(capture: Capture) -> Iterator[Finding]:
    """Check that no selected frame is lit by a flash: the person's colours are learnt from them."""
    for frame in capture.selected_frames or ():
        if lit_by_flash(capture, frame):
            yield Finding(
                "warning",
                "selected_frames",
                f"the selected frame {int(capture.video_frames[0, frame])} is in another light than those around it, "
                "as in a flash: select another one, a few frames before or after",
            )


def _apart(one: Float[np.ndarray, "band block"], other: Float[np.ndarray, "band block"]) -> float:
    return float(np.abs(np.median(one - other, axis=1)).max())


def _brightness(image: UInt8[np.ndarray, "height width 3"]) -> Float[np.ndarray, "band block"]:
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY).astype(np.float32)
    return np.log(cv2.resize(grey, (_BANDS, _BANDS), interpolation=cv2.INTER_AREA) + _BLACK)
