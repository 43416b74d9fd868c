"""The joint angles of the rest pose, read off its bone directions.

The rest pose is the neutral body of the DoF table bent by some angles. Knowing them, each axis of the table can be
carried to the rest pose by the rotations before it in the chain, and each limit shifted by its own angle. The left
side is solved; the right side is solved as its mirror image.
"""

from collections.abc import Mapping

import numpy as np

from jaxmocap.geometry import unit

_STRAIGHT_ELBOW = np.radians(10.0)  # below this bend the plane of the arm says nothing
_STRAIGHT_KNEE = np.radians(20.0)  # knees also bend sideways by a few degrees
_LATERAL_ARM = np.sin(np.radians(20.0))  # closer to sideways than this, flexion and axial rotation coincide
_MIRROR = np.diag([-1.0, 1.0, 1.0])
_X, _Y, _Z = np.eye(3)

_ARM, _LEG = {"shoulder", "elbow", "wrist"}, {"hip", "knee", "ankle"}

Frames = dict[str, np.ndarray]


def rest_angles(places: Mapping[str, np.ndarray]) -> tuple[dict[str, float], Frames]:
    """Measure the rest pose's angles (radians) by DoF name, and the rotation, neutral to rest, before each DoF.

    Names absent from the result are zero angles and identity rotations, those of limbs without places among them.
    """
    angles: dict[str, float] = {}
    frames: Frames = {}
    for side, mirror in (("l", np.eye(3)), ("r", _MIRROR)):
        at = {name[2:]: mirror @ place for name, place in places.items() if name.startswith(f"{side}_")}
        limbs = [limb(at) for limb, joints in ((_arm, _ARM), (_leg, _LEG)) if joints <= at.keys()]
        for side_angles, side_frames in limbs:
            angles.update({f"{side}_{name}": float(angle) for name, angle in side_angles.items()})
            # A reflection turns rotation R into M R M, which carries the mirrored axis of the table.
            frames.update({f"{side}_{name}": mirror @ frame @ mirror for name, frame in side_frames.items()})
    return angles, frames


def _arm(at: Mapping[str, np.ndarray]) -> tuple[dict[str, float], Frames]:
    upper = unit(at["elbow"] - at["shoulder"])
    fore = unit(at["wrist"] - at["elbow"])
    flex, lift = _arm_swing(upper)
    swung = _turn(-_X, flex)
    raised = _align(swung @ _turn(_Z, lift), _X, upper)
    axial = 0.0
    bend = _angle(upper, fore)
    if bend > _STRAIGHT_ELBOW:
        normal = raised.T @ unit(np.cross(upper, fore))  # the elbow axis, -y before axial rotation
        axial = np.arctan2(-normal[2], -normal[1])
    turned = raised @ _turn(_X, axial)
    direction = turned.T @ fore
    elbow = np.arctan2(direction[2], direction[0])
    forearm = _align(turned @ _turn(-_Y, elbow), _X, fore)
    angles = {"shoulder_flex": flex, "shoulder_abd": lift, "shoulder_axial": axial, "elbow_flex": elbow}
    frames = {
        "shoulder_abd": swung,
        "shoulder_axial": raised,
        "elbow_flex": turned,
        "forearm_pron": forearm,
        "wrist_flex": forearm,
        "wrist_dev": forearm,
    }
    return angles, frames


def _arm_swing(upper: np.ndarray) -> tuple[float, float]:
    """Flexion and abduction that bring an arm from straight sideways to a direction."""
    across = np.hypot(upper[1], upper[2])
    if across < _LATERAL_ARM:
        return 0.0, np.arctan2(upper[1], upper[0])
    if upper[1] > abs(upper[2]):  # raised above the shoulder
        return np.arctan2(-upper[2], upper[1]), np.arctan2(across, upper[0])
    return np.arctan2(upper[2], -upper[1]), np.arctan2(-across, upper[0])


def _leg(at: Mapping[str, np.ndarray]) -> tuple[dict[str, float], Frames]:
    thigh = unit(at["knee"] - at["hip"])
    shank = unit(at["ankle"] - at["knee"])
    flex, spread = np.arctan2(thigh[2], -thigh[1]), np.arcsin(thigh[0])
    swung = _turn(-_X, flex)
    spread_frame = swung @ _turn(_Z, spread)
    internal = 0.0
    if _angle(thigh, shank) > _STRAIGHT_KNEE:
        normal = spread_frame.T @ unit(np.cross(thigh, shank))  # the knee axis, x before axial rotation
        candidate = np.arctan2(normal[2], normal[0])
        internal = candidate if abs(candidate) < np.radians(60) else 0.0
    turned = spread_frame @ _turn(-_Y, internal)
    direction = turned.T @ shank
    knee = np.arctan2(-direction[2], -direction[1])
    lower = _align(turned @ _turn(_X, knee), -_Y, shank)
    foot = lower.T @ _Z  # feet are taken to point forward, flat on the ground
    dorsi = np.arctan2(foot[1], foot[2])
    sole = lower @ _turn(-_X, dorsi)
    angles = {"hip_flex": flex, "hip_abd": spread, "hip_int": internal, "knee_flex": knee, "ankle_dorsi": dorsi}
    frames = {
        "hip_abd": swung,
        "hip_int": spread_frame,
        "knee_flex": turned,
        "ankle_dorsi": lower,
        "ankle_inv": sole,
    }
    return angles, frames


def _angle(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))


def _turn(axis: np.ndarray, angle: float) -> np.ndarray:
    w = np.cross(np.eye(3), axis)
    return np.eye(3) + np.sin(angle) * w + (1 - np.cos(angle)) * w @ w


def _align(frame: np.ndarray, axis: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Turn a frame by the smallest rotation that makes its `axis` point along `direction`."""
    current = frame @ axis
    normal = np.cross(current, direction)
    size = np.linalg.norm(normal)
    if size < 1e-9:
        return frame
    return _turn(normal / size, _angle(current, direction)) @ frame
