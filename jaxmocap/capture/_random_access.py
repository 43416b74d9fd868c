"""Pictures of several videos in any order: open readers, and the last pictures kept."""

import contextlib
import threading
from collections import OrderedDict
from collections.abc import Callable, Iterable

import numpy as np
from jaxtyping import UInt8

from jaxmocap._results import InputError

from ._video import FrameReader, VideoIndex

CACHED_IMAGES = 8


class RandomAccess:
    """One open reader per camera and the last images, behind a lock."""

    def __init__(self, indices: tuple[VideoIndex, ...]):
        self._lock = threading.Lock()
        self._images: OrderedDict[tuple[int, int], UInt8[np.ndarray, "height width 3"]] = OrderedDict()
        self._indices = indices
        self._readers: dict[int, FrameReader] = {}

    def image(
        self, camera_index: int, frame: int, decode: Callable[[FrameReader], UInt8[np.ndarray, "height width 3"]]
    ) -> UInt8[np.ndarray, "height width 3"]:
        """Return an image that is kept, or decode it with its camera's reader; read-only."""
        key = (camera_index, frame)
        with self._lock:
            if key not in self._images:
                image = decode(self._reader(camera_index))
                image.flags.writeable = False
                self._images[key] = image
                if len(self._images) > CACHED_IMAGES:
                    self._images.popitem(last=False)
            self._images.move_to_end(key)
            return self._images[key]

    def _reader(self, camera_index: int) -> FrameReader:
        if camera_index not in self._readers:
            self._readers[camera_index] = FrameReader(self._indices[camera_index])
        return self._readers[camera_index]


def decode_ahead(
    image: Callable[[int, int], UInt8[np.ndarray, "height width 3"]], pairs: Iterable[tuple[int, int]]
) -> None:
    """Ask in a thread for the images of these cameras and frames; what goes wrong is said when they are asked for."""

    def decode() -> None:
        with contextlib.suppress(InputError, OSError):
            for camera, frame in pairs:
                image(camera, frame)

    threading.Thread(target=decode, name="frames ahead").start()
