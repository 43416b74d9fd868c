"""OpenPose keypoint files and masks, by camera and frame."""

import json
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Bool, Float64

from jaxmocap._results import InputError

KEYPOINT_NAMES = (
    "nose", "neck", "r_shoulder", "r_elbow", "r_wrist", "l_shoulder", "l_elbow", "l_wrist", "pelvis",
    "r_hip", "r_knee", "r_ankle", "l_hip", "l_knee", "l_ankle", "r_eye", "l_eye", "r_ear", "l_ear",
    "l_big_toe", "l_small_toe", "l_heel", "r_big_toe", "r_small_toe", "r_heel",
)  # fmt: skip
_OTHER_LAYOUTS = {51: "COCO (17 points)", 54: "COCO (18 points)", 45: "MPI (15 points)", 48: "MPII (16 points)",
                  399: "whole-body COCO (133 points)", 78: "Halpe (26 points)"}  # fmt: skip


def keypoint_file(folder: Path, camera: str, frame: int) -> Path:
    return folder / f"{camera}_{frame:05d}_keypoints.json"


def mask_file(folder: Path, camera: str, frame: int) -> Path:
    return folder / f"{camera}_{frame:05d}.png"


def read_people(file: Path) -> list[Float64[np.ndarray, "25 3"]]:
    """Read all people of an OpenPose BODY_25 file who have a point: x, y (pixels), confidence. Raises `InputError`."""
    try:
        document = json.loads(file.read_text(encoding="utf-8"))
        people = [person["pose_keypoints_2d"] for person in document["people"]]
    except OSError as error:
        raise InputError(f"keypoints {file} cannot be read: {error.strerror or error}") from error
    except (ValueError, RecursionError) as error:
        raise InputError(f"keypoints {file} is not JSON: {error}") from error
    except (KeyError, TypeError) as error:
        raise InputError(
            f'keypoints {file} is not an OpenPose file: expected {{"people": [{{"pose_keypoints_2d": [...]}}]}}'
        ) from error
    result = []
    for person in people:
        if not isinstance(person, list) or len(person) != 75:
            count = len(person) if isinstance(person, list) else 0
            layout = f", which looks like {_OTHER_LAYOUTS[count]}" if count in _OTHER_LAYOUTS else ""
            raise InputError(
                f"keypoints {file}: a person has {count} numbers{layout}; expected the 75 of OpenPose BODY_25 "
                "(25 points, x y confidence)"
            )
        try:
            points = np.asarray(person, float).reshape(25, 3)
        except (TypeError, ValueError, OverflowError):
            raise InputError(f"keypoints {file} holds something other than numbers") from None
        if not np.isfinite(points).all():
            raise InputError(f"keypoints {file} holds values that are not finite")
        if (points[:, 2] > 0).any():
            result.append(points)
    return result


def best_person(people: list[Float64[np.ndarray, "25 3"]]) -> Float64[np.ndarray, "25 3"] | None:
    """Choose the person of the largest mean confidence; None if there is nobody."""
    return max(people, key=lambda points: float(points[:, 2].mean()), default=None)


def read_mask(file: Path, size: tuple[int, int]) -> Bool[np.ndarray, "height width"]:
    """Read a mask image, true above half of its largest value. Raises `InputError` for a size unlike the video's."""
    image = cv2.imread(str(file), cv2.IMREAD_GRAYSCALE)
    if image is None:
        raise InputError(f"mask {file} cannot be read as an image")
    if image.shape[::-1] != size:
        raise InputError(
            f"mask {file} has {image.shape[1]}x{image.shape[0]} pixels, but its video has {size[0]}x{size[1]}; masks "
            "must have the size of the video"
        )
    return (image > image.max() / 2.0) & (image > 0)
