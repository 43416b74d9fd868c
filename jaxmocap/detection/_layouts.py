"""Keypoint layouts: the points of a person in the order in which programs write them, each layout one table."""

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from jaxtyping import Float64

LayoutName = Literal["body25", "coco17", "coco133", "halpe26", "halpe136", "blazepose33"]


@dataclass(frozen=True)
class Layout:
    """A keypoint layout.

    Attributes:
        title: as sentences name it.
        points: names in file order. Names are shared by all layouts, `l_` and `r_` are the person's left and right.
    """

    title: str
    points: tuple[str, ...]


def _numbered(name: str, count: int) -> tuple[str, ...]:
    return tuple(f"{name}_{number}" for number in range(count))


_FACE_AND_HANDS = (*_numbered("face", 68), *_numbered("l_hand", 21), *_numbered("r_hand", 21))

# Cao et al. 2019, OpenPose; doc/02_output.md of OpenPose
BODY_25 = Layout(
    "OpenPose BODY_25",
    (
        "nose", "neck", "r_shoulder", "r_elbow", "r_wrist", "l_shoulder", "l_elbow", "l_wrist", "mid_hip",
        "r_hip", "r_knee", "r_ankle", "l_hip", "l_knee", "l_ankle", "r_eye", "l_eye", "r_ear", "l_ear",
        "l_big_toe", "l_small_toe", "l_heel", "r_big_toe", "r_small_toe", "r_heel",
    ),
)  # fmt: skip

# Lin et al. 2014, Microsoft COCO
COCO_17 = Layout(
    "COCO (17 points)",
    (
        "nose", "l_eye", "r_eye", "l_ear", "r_ear", "l_shoulder", "r_shoulder", "l_elbow", "r_elbow",
        "l_wrist", "r_wrist", "l_hip", "r_hip", "l_knee", "r_knee", "l_ankle", "r_ankle",
    ),
)  # fmt: skip

# Jin et al. 2020, Whole-Body Human Pose Estimation in the Wild
COCO_133 = Layout(
    "whole-body COCO (133 points)",
    (
        *COCO_17.points,
        "l_big_toe", "l_small_toe", "l_heel", "r_big_toe", "r_small_toe", "r_heel",
        *_FACE_AND_HANDS,
    ),
)  # fmt: skip

# Fang et al. 2022, AlphaPose; Pose2Sim's default
HALPE_26 = Layout(
    "Halpe (26 points)",
    (
        *COCO_17.points,
        "head_top", "neck", "mid_hip",
        "l_big_toe", "r_big_toe", "l_small_toe", "r_small_toe", "l_heel", "r_heel",
    ),
)  # fmt: skip
HALPE_136 = Layout("Halpe (136 points)", (*HALPE_26.points, *_FACE_AND_HANDS))

# Bazarevsky et al. 2020, BlazePose; MediaPipe calls the tip of the foot foot_index
BLAZEPOSE_33 = Layout(
    "BlazePose (33 points)",
    (
        "nose", "l_eye_inner", "l_eye", "l_eye_outer", "r_eye_inner", "r_eye", "r_eye_outer", "l_ear", "r_ear",
        "l_mouth", "r_mouth", "l_shoulder", "r_shoulder", "l_elbow", "r_elbow", "l_wrist", "r_wrist",
        "l_pinky", "r_pinky", "l_index", "r_index", "l_thumb", "r_thumb", "l_hip", "r_hip", "l_knee", "r_knee",
        "l_ankle", "r_ankle", "l_heel", "r_heel", "l_big_toe", "r_big_toe",
    ),
)  # fmt: skip

LAYOUTS: dict[LayoutName, Layout] = dict(
    zip(get_args(LayoutName), (BODY_25, COCO_17, COCO_133, HALPE_26, HALPE_136, BLAZEPOSE_33), strict=True)
)
_MIDDLES = {"neck": ("l_shoulder", "r_shoulder"), "mid_hip": ("l_hip", "r_hip")}


def to_body_25(points: Float64[np.ndarray, "point 3"], layout: Layout) -> Float64[np.ndarray, "25 3"]:
    """Turn the points of a layout (x, y, confidence) into BODY_25's.

    Neck and middle of the hips, where the layout has none, are the mean of shoulders and hips with the smaller of both
    confidences; what else it lacks, and a mean of which one part was not found, is 0 with confidence 0.
    """
    known = dict(zip(layout.points, points, strict=True))
    result = np.zeros((25, 3))
    for row, name in enumerate(BODY_25.points):
        if name in known:
            result[row] = known[name]
        elif name in _MIDDLES:
            left, right = (known[part] for part in _MIDDLES[name])
            if min(left[2], right[2]) > 0:
                result[row] = (*(left[:2] + right[:2]) / 2, min(left[2], right[2]))
    return result
