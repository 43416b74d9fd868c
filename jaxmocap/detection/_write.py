"""Keypoints of one picture as a file in OpenPose's form, which says of itself how its points are laid out."""

import json
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64

from jaxmocap._files import write_text


def write_body_25(file: Path, points: Float64[np.ndarray, "25 3"], **about: Any) -> None:
    """Write the BODY_25 points (x, y in the video's pixels, confidence) of one person, atomically; of nobody where no
    point has a confidence. `about` are further entries of the file, which readers pass over."""
    rows = [[round(float(x), 2), round(float(y), 2), round(float(c), 4)] if c > 0 else [0, 0, 0] for x, y, c in points]
    people = [{"pose_keypoints_2d": [number for row in rows for number in row]}] if any(row[2] for row in rows) else []
    write_text(file, json.dumps({"version": 1.3, "keypoint_layout": "body25", **about, "people": people}) + "\n")
