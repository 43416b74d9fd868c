"""What static cameras see of a person over a clip, and what is known beforehand of bodies and lenses."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxmocap.capture import KEYPOINT_NAMES

from ._footage import CONFIDENT

JOINTS = (
    "nose", "l_ear", "r_ear", "l_shoulder", "r_shoulder", "l_elbow", "r_elbow", "l_wrist", "r_wrist", "l_hip", "r_hip",
    "l_knee", "r_knee", "l_ankle", "r_ankle", "l_heel", "r_heel", "l_big_toe", "r_big_toe",
)  # fmt: skip
"""Of BODY_25; not neck and pelvis, which some layouts make of others."""
_JUMP = 0.08  # of the person's size
_ROWS = np.array([KEYPOINT_NAMES.index(name) for name in JOINTS])


class Bone(NamedTuple):
    """A length that is the same at all frames, and on both sides.

    Attributes:
        ends: pairs of joints of this length.
        spread: of what a detector makes of it from frame to frame, relative.
        part: of the person's height, in the mean; None where detectors differ.
        deviation: of `part`, relative: people differ, and where detectors see the joints.
    """

    ends: tuple[tuple[str, str], ...]
    spread: float
    part: float | None = None
    deviation: float = 0.06


# Parts of the height: Drillis and Contini 1966; the upper arm as in `_scale.PARTS_OF_HEIGHT`
RIGID: dict[str, Bone] = {
    "upper_arm": Bone((("l_shoulder", "l_elbow"), ("r_shoulder", "r_elbow")), 0.06, 0.16),
    "forearm": Bone((("l_elbow", "l_wrist"), ("r_elbow", "r_wrist")), 0.06, 0.146),
    "thigh": Bone((("l_hip", "l_knee"), ("r_hip", "r_knee")), 0.05, 0.245),
    "shank": Bone((("l_knee", "l_ankle"), ("r_knee", "r_ankle")), 0.05, 0.246),
    "trunk": Bone((("l_shoulder", "l_hip"), ("r_shoulder", "r_hip")), 0.08, 0.288, 0.08),
    "shoulders": Bone((("l_shoulder", "r_shoulder"),), 0.08),
    "hips": Bone((("l_hip", "r_hip"),), 0.12),
    "foot": Bone((("l_heel", "l_big_toe"), ("r_heel", "r_big_toe")), 0.1),
    "head": Bone((("l_ear", "r_ear"),), 0.15),
}


class Keypoints(NamedTuple):
    """A person's joints (`JOINTS`) in all cameras over the shared frames.

    Attributes:
        pixels: lenses' distortion taken out; those that were not seen are 0.
        seen: whether the detector is sure of them.
        seconds: of each camera's frames on the common clock, as far as the offsets are known.
        velocity: pixels a second; 0 where it is not known.
    """

    pixels: Float[np.ndarray, "camera frame joint 2"]
    seen: Bool[np.ndarray, "camera frame joint"]
    seconds: Float[np.ndarray, "camera frame"]
    velocity: Float[np.ndarray, "camera frame joint 2"]

    def at(self, frames: Int[np.ndarray, " chosen"]) -> "Keypoints":
        """Take some frames."""
        return Keypoints(*(part[:, frames] for part in self))

    @property
    def together(self) -> Bool[np.ndarray, "frame joint"]:
        """Which joints two cameras see."""
        return self.seen.sum(axis=0) >= 2


class Beliefs(NamedTuple):
    """What is known beforehand, with standard deviations; 0 holds what it is about.

    Attributes:
        focal: lengths, pixels.
        focal_deviation: relative, of each.
        alike: of the ratio of two cameras' focal lengths over their guesses, relative.
        late: of a clock, seconds.
        bones: metres and relative deviation, by name.
    """

    focal: Float[np.ndarray, " camera"]
    focal_deviation: Float[np.ndarray, " camera"]
    alike: float
    late: float
    bones: dict[str, tuple[float, float]]


class Noise(NamedTuple):
    """How exact keypoints are.

    Attributes:
        sigma: standard deviation by camera, pixels.
        weight: of a frame, below 1 where keypoints of neighbouring frames err alike.
    """

    sigma: Float[np.ndarray, " camera"]
    weight: float


def person_keypoints(
    body_25: Float[np.ndarray, "camera frame 25 3"], seconds: Float[np.ndarray, "camera frame"]
) -> Keypoints:
    """Take `JOINTS` of BODY_25 points (x, y, confidence), without those that jump, and their velocities."""
    chosen = body_25[:, :, _ROWS]
    seen, still = chosen[..., 2] >= CONFIDENT, np.zeros_like(chosen[..., :2])
    return _with_velocity(remove_jumps(Keypoints(chosen[..., :2].copy(), seen, np.asarray(seconds, float), still)))


def body_size(points: Keypoints) -> Float[np.ndarray, " camera"]:
    """Measure how large the person is in each camera, in pixels: the median extent over frames."""
    sizes = []
    for pixels, seen in zip(points.pixels, points.seen, strict=True):
        extents = [np.ptp(p[s], axis=0).max() for p, s in zip(pixels, seen, strict=True) if s.sum() >= 4]
        sizes.append(float(np.median(extents)) if extents else 1.0)
    return np.array(sizes)


def remove_jumps(points: Keypoints, reach: int = 2) -> Keypoints:
    """Replace keypoints by a robust straight line over `reach` frames on either side, which takes half of the noise.

    Those that are far from it are taken out.
    """
    size = body_size(points)[:, None, None]
    frames = np.arange(points.pixels.shape[1])[:, None] + np.arange(-reach, reach + 1)
    inside = (frames >= 0) & (frames < len(frames))
    frames = frames.clip(0, len(frames) - 1)
    near = points.pixels[:, frames]  # camera frame neighbour joint 2
    here = points.seen[:, frames] & inside[None, :, :, None]
    step = np.arange(-reach, reach + 1)[:, None]
    shown = np.ma.masked_array(near, np.broadcast_to(~here[..., None], near.shape))
    start = np.ma.median(shown, axis=2).filled(0.0)
    away = np.linalg.norm(near - start[:, :, None], axis=-1)
    line = start
    for _ in range(4):  # least summed distance, reweighted
        weight = here / np.maximum(away, 0.01 * size[..., None])
        total, first, second = (np.sum(weight * step**power, axis=2) for power in (0, 1, 2))
        value = np.sum(weight[..., None] * near, axis=2)
        slope = np.sum((weight * step)[..., None] * near, axis=2)
        second = second + 1e-3 * total
        scale = np.maximum(total * second - first**2, 1e-12)[..., None]
        line = (second[..., None] * value - first[..., None] * slope) / scale
        tilt = (total[..., None] * slope - first[..., None] * value) / scale
        away = np.linalg.norm(near - line[:, :, None] - tilt[:, :, None] * step[..., None], axis=-1)
    enough = here.sum(axis=2) >= 3
    off = np.linalg.norm(points.pixels - line, axis=-1)
    seen = points.seen & (~enough | (off < _JUMP * size))
    return points._replace(pixels=np.where((enough & seen)[..., None], line, points.pixels), seen=seen)


def _with_velocity(points: Keypoints) -> Keypoints:
    """Add velocities, by the frames before and after."""
    result = np.zeros_like(points.pixels)
    step = points.seconds[:, 2:] - points.seconds[:, :-2]
    both = points.seen[:, 2:] & points.seen[:, :-2] & (step > 0)[:, :, None]
    moved = (points.pixels[:, 2:] - points.pixels[:, :-2]) / np.maximum(step, 1e-9)[:, :, None, None]
    result[:, 1:-1] = np.where(both[..., None], moved, 0.0)
    return points._replace(velocity=result)


def believed_lengths(lengths: Mapping[str, float]) -> dict[str, tuple[float, float]]:
    """Say what is believed of the bones beforehand, in metres, with relative deviations.

    These are `lengths` that are known, else those of the mean adult of 1.7 metres.
    """
    found = {}
    for name, bone in RIGID.items():
        if name in lengths:
            found[name] = (lengths[name], 0.05)
        elif bone.part is not None and not lengths:
            found[name] = (1.7 * bone.part, bone.deviation)
    return found
