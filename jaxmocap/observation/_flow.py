"""Dense optical flow between two pictures, with its own check; between consecutive frames it is computed ahead."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, NamedTuple, TypeVar

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from jaxmocap._runtime import cores

LONGEST_SIDE = 1280
"""The flow between whole frames is computed on images not larger than this."""

Image = UInt8[np.ndarray, "height width 3"]
Shown = TypeVar("Shown")

_PRESETS = {
    "ultrafast": cv2.DISOPTICAL_FLOW_PRESET_ULTRAFAST,
    "fast": cv2.DISOPTICAL_FLOW_PRESET_FAST,
    "medium": cv2.DISOPTICAL_FLOW_PRESET_MEDIUM,
}


def dense_flow(
    first: UInt8[np.ndarray, "height width"], second: UInt8[np.ndarray, "height width"], preset: str = "medium"
) -> Float[np.ndarray, "height width 2"]:
    """Compute DIS optical flow (Kroeger et al. 2016): `first(p)` is at `p + flow(p)` in `second`, pixels (dx, dy)."""
    pair = np.ascontiguousarray(first), np.ascontiguousarray(second)
    method: Any = cv2.DISOpticalFlow.create(_PRESETS[preset])  # its stub does not know that no flow may be given
    return method.calc(*pair, None)


def flow_both_ways(
    first: UInt8[np.ndarray, "height width"], second: UInt8[np.ndarray, "height width"], preset: str = "medium"
) -> tuple[Float[np.ndarray, "height width 2"], Float[np.ndarray, "height width 2"]]:
    """Compute the flow from the first picture to the second and back, at the same time where there are many cores."""
    if cores() <= 4:  # the threads of whoever calls this keep them busy
        return dense_flow(first, second, preset), dense_flow(second, first, preset)
    with ThreadPoolExecutor(1) as pool:
        back = pool.submit(dense_flow, second, first, preset)
        return dense_flow(first, second, preset), back.result()


def flow_agrees(
    forward: Float[np.ndarray, "height width 2"], backward: Float[np.ndarray, "height width 2"], slack: float = 0.5
) -> Bool[np.ndarray, "height width"]:
    """Check flow both ways (Sundaram, Brox, Keutzer 2010): |F + B(p + F)|^2 < 0.01 (|F|^2 + |B|^2) + slack."""
    height, width = forward.shape[:2]
    x, y = np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32)[:, None]
    there = x + forward[..., 0], y + forward[..., 1]
    returned = cv2.remap(backward, *there, cv2.INTER_LINEAR, borderValue=(1e3, 1e3))
    return squared_length(forward + returned) < 0.01 * (squared_length(forward) + squared_length(returned)) + slack


def squared_length(flow: Float[np.ndarray, "height width 2"]) -> Float[np.ndarray, "height width"]:
    """Square a flow's length, pixels^2."""
    return flow[..., 0] ** 2 + flow[..., 1] ** 2


def sample_picture(picture: np.ndarray, columns: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Sample a picture bilinearly at pixel positions; the centre of its first pixel is (0.5, 0.5)."""
    return cv2.remap(
        picture,
        (columns - 0.5).astype(np.float32),
        (rows - 0.5).astype(np.float32),
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REPLICATE,
    )


class FrameFlow(NamedTuple):
    """The flow from a whole frame to another of the same camera, on images made small, and where it agrees with the
    flow back."""

    forward: Float[np.ndarray, "rows columns 2"]
    agrees: Bool[np.ndarray, "rows columns"]


def frame_flow(before: Image, after: Image) -> FrameFlow:
    """Compute the flow from one whole frame to another of the same size."""
    height, width = before.shape[:2]
    scale = min(1.0, LONGEST_SIDE / max(height, width))
    size = (round(width * scale), round(height * scale))
    pictures = []
    for image in (before, after):
        grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
        pictures.append(grey if scale == 1 else cv2.resize(grey, size, interpolation=cv2.INTER_AREA))
    forward, backward = flow_both_ways(*pictures)
    return FrameFlow(forward, flow_agrees(forward, backward, 0.1))


class FlowAhead:
    """Flow between consecutive frames, computed in other threads while the earlier frame is still being tracked."""

    def __init__(self) -> None:
        self._here: dict[int, tuple[Image, Image, Future[FrameFlow]]] = {}

    def follow(self, frames: Iterable[Shown], images: Callable[[Shown], Sequence[Image]]) -> Iterator[Shown]:
        """Pass frames on, each once the next one is decoded and its flow is on the way.

        A frame that cannot be decoded fails after the one before it has been passed on.
        """
        coming = iter(frames)
        before, failure = next(coming, None), None
        ahead: dict[int, tuple[Image, Image, Future[FrameFlow]]] = {}
        with ThreadPoolExecutor(max(cores() // 2, 1)) as pool:
            while before is not None:
                try:
                    after = next(coming, None)
                except Exception as error:
                    after, failure = None, error
                pairs = [] if after is None else zip(images(before), images(after), strict=True)
                self._here, ahead = ahead, {k: (*p, pool.submit(frame_flow, *p)) for k, p in enumerate(pairs)}
                yield before
                if failure is not None:
                    raise failure
                before = after

    def between(self, camera: int, before: Image, after: Image) -> FrameFlow:
        """Return the flow to a camera's image of the frame last passed on from the one before: what was computed ahead,
        if it was between just these images."""
        first, second, found = self._here.get(camera, (None, None, None))
        if found is None or first is not before or second is not after:
            return frame_flow(before, after)
        return found.result()
