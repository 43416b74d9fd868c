"""Does a triangulated person face the way knees, feet and nose say, or is it inside out as mirrored cameras make it?"""

from collections.abc import Iterable, Iterator

import numpy as np
from jaxtyping import Float

from ._findings import Finding
from ._keypoints import KEYPOINT_NAMES

_FEWEST = 3
_TURNED = -0.5


def _ahead(points: Float[np.ndarray, "25 3"]) -> Float[np.ndarray, "5"]:
    """Metres by which the nose, the knees and the big toes are ahead of neck, leg and ankle; NaN where unseen.

    Ahead is left x up, so its sign turns with the handedness of the points: of a person these are nearly all positive.
    """
    place: dict[str, np.ndarray] = dict(zip(KEYPOINT_NAMES, points, strict=True))

    def ahead(left: np.ndarray, up: np.ndarray, by: np.ndarray) -> float:
        forward = np.cross(left, up)
        length = np.linalg.norm(forward)
        return float(by @ forward / length) if length > 0 else np.nan

    hips = place["l_hip"] - place["r_hip"]
    shoulders = place["l_shoulder"] - place["r_shoulder"]
    found = [ahead(hips + shoulders, place["neck"] - place["pelvis"], place["nose"] - place["neck"])]
    for side in ("l", "r"):
        hip, knee = place[f"{side}_hip"], place[f"{side}_knee"]
        ankle, toe = place[f"{side}_ankle"], place[f"{side}_big_toe"]
        found += [ahead(hips, hip - ankle, knee - (hip + ankle) / 2), ahead(hips, hip - ankle, toe - ankle)]
    return np.array(found)


def handedness_findings(people: Iterable[Float[np.ndarray, "25 3"]], trusted: bool) -> Iterator[Finding]:
    """An error (a warning, where depth is not `trusted`) when all frames together say that the person is inside out."""
    ahead = np.concatenate([_ahead(points) for points in people] or [np.zeros(0)])
    ahead = ahead[np.isfinite(ahead)]
    if len(ahead) >= _FEWEST and ahead.sum() < _TURNED * np.abs(ahead).sum():
        yield Finding(
            "error" if trusted else "warning",
            "cameras",
            "the triangulated keypoints make a person whose knees, feet and nose point backwards: the cameras are "
            "mirrored (an axis of their world is reversed; export them right-handed), or left and right are exchanged "
            "in the keypoints",
        )
