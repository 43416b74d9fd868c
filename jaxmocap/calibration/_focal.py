"""A first guess of a camera's focal length."""

from pathlib import Path

import av

_USUAL = 0.9  # of the longer side: phones filming are between 0.7 and 1.2
_FULL_FRAME_DIAGONAL = 43.27  # millimetres


def guess_focal(path: Path, size: tuple[int, int]) -> float:
    """Pixels: from the 35 mm equivalent that some phones write into a video's metadata, else what is usual."""
    with av.open(str(path)) as container:
        metadata = {**container.metadata, **container.streams.video[0].metadata}
    for key, value in metadata.items():
        if "focal_length" in key.lower() and "35mm" in key.lower().replace(" ", "").replace("_", ""):
            try:
                equivalent = float(value)
            except ValueError:
                continue
            if 8 <= equivalent <= 400:
                return equivalent / _FULL_FRAME_DIAGONAL * float((size[0] ** 2 + size[1] ** 2) ** 0.5)
    return _USUAL * max(size)
