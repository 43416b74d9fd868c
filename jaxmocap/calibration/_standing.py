"""Which way is up, from a person who walks about before static cameras: feet, body and levelled tripods together."""

import numpy as np
from jaxtyping import Float
from scipy.optimize import least_squares

from ._person_scene import JOINTS
from ._world import Gravity, Plane

_BODY = np.radians(6.0)  # of the mean axis of a body over a clip
_LEVEL = np.radians(4.0)  # of a camera's x axis from level
_FOOT = 0.03  # metres, of the lowest point of the feet above the ground
_ALIKE = 10  # frames whose errors are alike
_FEET = [JOINTS.index(name) for name in ("l_heel", "r_heel", "l_big_toe", "r_big_toe")]
_ANKLES = [JOINTS.index(name) for name in ("l_ankle", "r_ankle")]
_SHOULDERS = [JOINTS.index(name) for name in ("l_shoulder", "r_shoulder")]
_ANKLE_HEIGHT = 0.08  # metres
_DIFFER = 15.0  # degrees


def find_up(
    cam_from_world: Float[np.ndarray, "pose 4 4"],
    joints: Float[np.ndarray, "frame joint 3"],
    metres_per_unit: float,
    given: Float[np.ndarray, "3"] | None = None,
) -> Gravity:
    """Find up where the lowest points of the feet make a level ground, which the mean axis of the body and the cameras'
    x axes complete where the feet keep to a line; `given` by hand, else.

    Leaps do not count (Cauchy's loss). The feet's ground is a plane at right angles to up.
    """
    across = cam_from_world[:, 0, :3]
    body = _body_axis(joints, -cam_from_world[:, 1, :3].mean(0))
    feet = joints[:, _FEET]
    under = 0.0
    if np.isfinite(feet).all(-1).any(-1).sum() < 10:
        feet, under = joints[:, _ANKLES], _ANKLE_HEIGHT
    feet = metres_per_unit * feet[np.isfinite(feet).all(-1).any(-1)]
    sides = np.linalg.svd(body[None])[2][1:]

    def direction(values: np.ndarray) -> np.ndarray:
        up = body + values[:2] @ sides
        return up / np.linalg.norm(up)

    def lowest(up: np.ndarray) -> np.ndarray:
        return np.nanmin(feet @ up, axis=1)

    def rows(values: np.ndarray) -> np.ndarray:
        up = direction(values)
        heights = (lowest(up) - values[2]) / _FOOT
        return np.concatenate(
            [_cauchy(heights) / np.sqrt(_ALIKE), np.arctan(values[:2]) / _BODY, _cauchy(across @ up / _LEVEL)]
        )

    start = np.array([0.0, 0.0, float(np.median(lowest(body))) if len(feet) else 0.0])
    values = least_squares(rows, start, x_scale="jac").x
    up = direction(values) if given is None else given / np.linalg.norm(given)
    ground = None
    if len(feet):
        heights = lowest(up)
        level = values[2] if given is None else float(np.median(heights))
        count = int((np.abs(heights - level) < 2 * _FOOT).sum())
        ground = Plane(up, (level - under) / metres_per_unit, count)
    level_axis = _level(across, up)
    cues = {"person": body, "cameras": level_axis}
    differences = {name: float(np.degrees(np.arccos(np.clip(cue @ up, -1, 1)))) for name, cue in cues.items()}
    source = "ground under the feet" if given is None else "given"
    warnings = tuple(
        f"up is taken from the {source}, but the {name} would have it {angle:.0f} degrees elsewhere: if the result "
        "leans, give it with --up"
        for name, angle in differences.items()
        if name == "person" and angle > _DIFFER
    )
    return Gravity(up, source, ground, differences, warnings)


def _cauchy(rows: np.ndarray) -> np.ndarray:
    """Rows whose squares are Cauchy's loss: a leap, or a tripod that is not level."""
    return 2 * np.sign(rows) * np.sqrt(np.log1p(rows**2 / 4))


def _body_axis(joints: np.ndarray, about_up: np.ndarray) -> np.ndarray:
    """Find the median direction from between the ankles to between the shoulders."""
    axes = joints[:, _SHOULDERS].mean(1) - joints[:, _ANKLES].mean(1)
    axes = axes[np.isfinite(axes).all(1)]
    if not len(axes):
        return about_up / np.linalg.norm(about_up)
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    mean = np.median(axes, axis=0)
    return mean / np.linalg.norm(mean)


def _level(across: np.ndarray, up: np.ndarray) -> np.ndarray:
    """Find the direction nearest to up that is at right angles to all cameras' x axes, or most nearly so."""
    _, values, vectors = np.linalg.svd(across)
    normal = vectors[2]
    if len(values) > 1 and values[1] > 0.1 * values[0]:
        return normal if normal @ up > 0 else -normal
    flat = up - (up @ vectors[0]) * vectors[0]
    return flat / np.linalg.norm(flat)
