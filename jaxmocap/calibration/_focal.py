"""A first guess of a camera's focal length."""

import re
from pathlib import Path

import av

_USUAL = 0.9  # of the longer side: phones filming are between 0.7 and 1.2
_FULL_FRAME_DIAGONAL = 43.27  # millimetres
_KEY = re.compile(r"focal_?length.*35_?mm", re.IGNORECASE)
_NUMBER = re.compile(r"\s*(\d+(?:\.\d+)?)\s*(?:mm)?\s*$")


def guess_focal(path: Path, size: tuple[int, int]) -> float:
    """Pixels: from the 35 mm equivalent that some phones write into a video's metadata, else what is usual.

    Read are QuickTime's `com.apple.quicktime.camera.focal_length.35mm_equivalent` and Exif's `FocalLengthIn35mmFormat`
    (or `...Film`), of the file or of its video track. The search begins there; phones crop what they film.
    """
    with av.open(str(path)) as container:
        metadata = {**container.metadata, **container.streams.video[0].metadata}
    for key, value in metadata.items():
        number = _NUMBER.match(value)
        if _KEY.search(key) and number and 8 <= float(number[1]) <= 400:
            return float(number[1]) / _FULL_FRAME_DIAGONAL * float((size[0] ** 2 + size[1] ** 2) ** 0.5)
    return _USUAL * max(size)
