"""The anatomy of the synthetic actor: joint positions and the signed distance of the skin, all proportions, no data.

Everything here is written for a person of 1.75 m in the rest pose (feet on y = 0, arms 45 degrees below horizontal,
elbows a little bent); the actor is scaled afterwards, so the mesh has the same triangles at every height.
"""

import numpy as np
from jaxtyping import Float
from scipy.interpolate import PchipInterpolator

TEMPLATE_HEIGHT = 1.75

CENTRE_JOINTS: dict[str, tuple[float, float, float]] = {
    "pelvis": (0.0, 0.955, 0.0),
    "spine": (0.0, 1.04, -0.02),
    "thorax": (0.0, 1.22, -0.03),
    "neck": (0.0, 1.475, -0.03),
    "head": (0.0, 1.575, 0.0),
    "head_top": (0.0, 1.75, 0.0),
    "nose": (0.0, 1.618, 0.112),
}
SIDE_JOINTS: dict[str, tuple[float, float, float]] = {
    "clavicle": (0.035, 1.41, 0.02),
    "shoulder": (0.178, 1.415, -0.02),
    "elbow": (0.383, 1.21, -0.03),
    "wrist": (0.553, 1.036, 0.025),
    "knuckles": (0.611, 0.974, 0.055),
    "fingertips": (0.655, 0.915, 0.083),
    "thumb": (0.606, 1.000, 0.108),
    "hip": (0.095, 0.92, 0.0),
    "knee": (0.123, 0.505, 0.012),
    "ankle": (0.142, 0.085, -0.02),
    "heel": (0.142, 0.02, -0.075),
    "toe": (0.175, 0.02, 0.17),
    "eye": (0.032, 1.652, 0.085),
    "ear": (0.078, 1.635, 0.0),
}

# Torso: height, half width, half depth, centre in z.
_TORSO = np.array(
    [
        [0.80, 0.120, 0.085, -0.010],
        [0.86, 0.162, 0.104, -0.012],
        [0.92, 0.171, 0.113, -0.012],
        [0.98, 0.168, 0.110, -0.006],
        [1.05, 0.149, 0.101, 0.000],
        [1.11, 0.146, 0.100, 0.004],
        [1.19, 0.153, 0.108, 0.004],
        [1.27, 0.168, 0.117, 0.000],
        [1.34, 0.172, 0.111, -0.008],
        [1.40, 0.150, 0.090, -0.016],
        [1.45, 0.104, 0.068, -0.022],
        [1.50, 0.060, 0.050, -0.020],
    ]
)
_torso_profile = PchipInterpolator(_TORSO[:, 0], _TORSO[:, 1:])


def side_joint(name: str, side: float) -> np.ndarray:
    """Place a joint of the left (+1) or right (-1) side, metres."""
    return np.asarray(SIDE_JOINTS[name]) * (side, 1, 1)


def sheared(points: Float[np.ndarray, "*point 3"], direction: float = 1.0) -> Float[np.ndarray, "*point 3"]:
    """Raise points with their distance from the torso, which makes the sloping arms horizontal; -1 undoes it."""
    outwards = np.abs(points[..., 0]) - np.asarray(0.178, points.dtype)
    lift = 0.5 * (outwards + np.sqrt(outwards**2 + np.asarray(0.0016, points.dtype)))
    return np.stack([points[..., 0], points[..., 1] + direction * lift, points[..., 2]], axis=-1)


def _smooth_min(a: np.ndarray, b: np.ndarray, width: float) -> np.ndarray:
    """Take a smooth minimum (polynomial): equal to min(a, b) where they differ by more than `width`."""
    h = np.maximum(width - np.abs(a - b), 0) / width
    return np.minimum(a, b) - 0.25 * width * h**2


def _ellipsoid(points: np.ndarray, centre: tuple[float, float, float], radii: tuple[float, float, float]) -> np.ndarray:
    p = (points - centre) / radii
    k0 = np.linalg.norm(p, axis=1)
    k1 = np.linalg.norm(p / radii, axis=1)
    return k0 * (k0 - 1) / np.maximum(k1, 1e-9)


def _limb(
    points: np.ndarray, start: np.ndarray, end: np.ndarray, radii: list[tuple[float, float]], flat: float = 1.0
) -> np.ndarray:
    """Measure the distance to a capsule whose radius follows a profile of (fraction of the length, radius).

    `flat` thins it across the x axis turned perpendicular to the limb.
    """
    axis = end - start
    length = np.linalg.norm(axis)
    axis = axis / length
    profile = np.asarray(radii)
    fraction = np.clip((points - start) @ axis / length, 0, 1)
    away = points - start - (fraction * length)[:, None] * axis
    if flat != 1.0:
        thin = np.array([1.0, 0, 0]) - axis[0] * axis
        thin /= np.linalg.norm(thin)
        away = away + ((1 / flat - 1) * (away @ thin))[:, None] * thin
    radius = PchipInterpolator(profile[:, 0], profile[:, 1])(fraction)
    return (np.linalg.norm(away, axis=1) - radius) * (flat if flat != 1.0 else 1.0)


def _torso(points: np.ndarray) -> np.ndarray:
    half_width, half_depth, centre = _torso_profile(np.clip(points[:, 1], 0.80, 1.50)).T
    x, z = np.abs(points[:, 0]) / half_width, np.abs(points[:, 2] - centre) / half_depth
    wall = ((x**2.4 + z**2.4 + 1e-12) ** (1 / 2.4) - 1) * half_depth
    ends = np.maximum(0.865 - points[:, 1], points[:, 1] - 1.49)
    return -_smooth_min(-wall, -ends, 0.06)


def _head(points: np.ndarray) -> np.ndarray:
    cranium = _ellipsoid(points, (0, 1.655, -0.004), (0.078, 0.097, 0.098))
    jaw = _ellipsoid(points, (0, 1.592, 0.033), (0.056, 0.066, 0.068))
    skull = _smooth_min(cranium, jaw, 0.05)
    nose = _limb(points, np.array([0, 1.65, 0.088]), np.array([0, 1.618, 0.103]), [(0, 0.009), (1, 0.014)])
    for side in (-1.0, 1.0):
        skull = _smooth_min(skull, _ellipsoid(points, (side * 0.079, 1.635, -0.008), (0.011, 0.031, 0.022)), 0.012)
    skull = _smooth_min(skull, nose, 0.02)
    neck = _limb(points, np.array([0, 1.44, -0.03]), np.array([0, 1.60, -0.008]), [(0, 0.062), (0.5, 0.053), (1, 0.05)])
    return _smooth_min(skull, neck, 0.04)


def _arm(points: np.ndarray, side: float) -> np.ndarray:
    shoulder, elbow, wrist = (side_joint(name, side) for name in ("shoulder", "elbow", "wrist"))
    knuckles, tips, thumb = (side_joint(name, side) for name in ("knuckles", "fingertips", "thumb"))
    upper = _limb(points, shoulder, elbow, [(0, 0.056), (0.25, 0.053), (0.55, 0.047), (0.9, 0.040), (1, 0.039)])
    lower = _limb(points, elbow, wrist, [(0, 0.039), (0.25, 0.043), (0.7, 0.033), (1, 0.027)])
    palm = _limb(points, wrist, knuckles, [(0, 0.031), (0.5, 0.042), (1, 0.044)], flat=0.45)
    fingers = _limb(points, knuckles, tips, [(0, 0.043), (0.7, 0.038), (1, 0.026)], flat=0.45)
    root = wrist + 0.40 * (knuckles - wrist) + np.array([0, 0, 0.020])
    hand = _smooth_min(palm, fingers, 0.02)
    hand = _smooth_min(hand, _limb(points, root, thumb, [(0, 0.020), (1, 0.015)]), 0.02)
    arm = _smooth_min(upper, lower, 0.03)
    trapezius = _limb(points, np.array([side * 0.02, 1.49, -0.035]), shoulder, [(0, 0.045), (0.6, 0.047), (1, 0.055)])
    return _smooth_min(_smooth_min(arm, hand, 0.02), trapezius, 0.03)


def _leg(points: np.ndarray, side: float) -> np.ndarray:
    hip, knee, ankle = (side_joint(name, side) for name in ("hip", "knee", "ankle"))
    thigh = _limb(points, hip, knee, [(0, 0.086), (0.25, 0.081), (0.6, 0.069), (0.9, 0.056), (1, 0.054)])
    shank = _limb(points, knee, ankle, [(0, 0.053), (0.25, 0.053), (0.6, 0.045), (0.9, 0.037), (1, 0.037)])
    calf = _ellipsoid(points, (side * 0.128, 0.385, -0.012), (0.046, 0.11, 0.050))
    foot = _limb(
        points,
        side_joint("heel", side) + (0, 0.025, 0.012),
        side_joint("toe", side) + (0, 0.005, -0.02),
        [(0, 0.041), (0.55, 0.045), (0.85, 0.043), (1, 0.036)],
    )
    instep = _limb(points, ankle, side_joint("toe", side) + (0, 0.015, -0.075), [(0, 0.04), (1, 0.035)])
    foot = _smooth_min(foot, instep, 0.03)
    foot = -_smooth_min(-foot, points[:, 1], 0.008)
    leg = _smooth_min(_smooth_min(thigh, _smooth_min(shank, calf, 0.025), 0.03), foot, 0.025)
    buttock = _ellipsoid(points, (side * 0.078, 0.905, -0.048), (0.083, 0.088, 0.078))
    return _smooth_min(leg, buttock, 0.03)


def skin_distance(points: Float[np.ndarray, "point 3"]) -> Float[np.ndarray, "point"]:
    """Approximate the signed distance of the skin of the 1.75 m template, metres, negative inside."""
    legs = _smooth_min(_leg(points, 1.0), _leg(points, -1.0), 0.03)
    body = _smooth_min(_torso(points), legs, 0.035)
    for side in (1.0, -1.0):
        body = _smooth_min(body, _ellipsoid(points, (side * 0.080, 1.325, 0.050), (0.085, 0.060, 0.05)), 0.06)
        body = _smooth_min(body, _arm(points, side), 0.035)
    return _smooth_min(body, _head(points), 0.035)
