"""Pictures as files, and masks in words."""

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np


def write_png(path: Path, image: "np.ndarray") -> None:
    """Write an RGB uint8 image, atomically."""
    import cv2

    from jaxmocap._files import write_bytes

    write_bytes(path, cv2.imencode(".png", cv2.cvtColor(image, cv2.COLOR_RGB2BGR))[1].tobytes())


def mask_words(entry: dict) -> str:
    """An entry of a mask record in a word or two."""
    return f"{entry['source']} {entry['confidence']:.2f}" if "confidence" in entry else entry["source"]
