"""Which pairs of frames are matched: key frames widely, the others with the key frames around them."""

from itertools import combinations

import numpy as np

from ._footage import Footage

Place = tuple[int, int]
"""Camera and frame."""

_WITHIN = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32)  # key frames apart, in one camera
_ACROSS = 4  # key frames apart, between two cameras


def key_pairs(footage: Footage) -> list[tuple[Place, Place]]:
    """Pairs of key frames: at growing distances within a camera, and all that are near in time between cameras."""
    keys = [footage.key_frames(camera) for camera in range(len(footage.videos))]
    pairs = []
    for camera, frames in enumerate(keys):
        for step in _WITHIN:
            pairs += [((camera, a), (camera, b)) for a, b in zip(frames, frames[step:], strict=False)]
    for one, other in combinations(range(len(keys)), 2):
        times = np.array([footage.instant(other, frame) for frame in keys[other]])
        for frame in keys[one]:
            nearest = np.argsort(np.abs(times - footage.instant(one, frame)), kind="stable")[: 2 * _ACROSS + 1]
            pairs += [((one, frame), (other, keys[other][int(index)])) for index in sorted(nearest)]
    return pairs


def frame_pairs(footage: Footage, camera: int, frame: int) -> list[Place]:
    """What a frame between the key frames is matched with: the three key frames
    nearest in time of its own camera and one of every other."""
    places = []
    for other in range(len(footage.videos)):
        frames = np.array(footage.key_frames(other))
        away = np.abs(footage.instant(camera, frame) - np.array([footage.instant(other, int(f)) for f in frames]))
        nearest = np.argsort(away, kind="stable")[: 3 if other == camera else 1]
        places += [(other, int(frames[index])) for index in sorted(nearest)]
    return places
