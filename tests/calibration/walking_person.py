"""A person walking on an oval before static cameras, and what a detector makes of it, with everything known."""

from typing import NamedTuple

import numpy as np
from moving_cameras import look
from scipy.spatial.transform import Rotation

from jaxmocap.calibration._person_scene import JOINTS
from jaxmocap.capture import KEYPOINT_NAMES

ROWS = [KEYPOINT_NAMES.index(name) for name in JOINTS]
FPS = 30


class Walk(NamedTuple):
    """BODY_25 keypoints (camera, frame, 25, 3), the cameras and lenses, and the person's height in metres."""

    keypoints: np.ndarray
    poses: np.ndarray
    focal: np.ndarray
    size: tuple[int, int]
    height: float
    joints: np.ndarray

    @property
    def seconds(self) -> np.ndarray:
        return np.tile(np.arange(self.keypoints.shape[1]) / FPS, (len(self.poses), 1))


def _bent(angles: np.ndarray) -> Rotation:
    return Rotation.from_rotvec(angles[:, None] * [1.0, 0.0, 0.0])


def walking(generator: np.random.Generator, count: int, reach: float = 1.0) -> tuple[np.ndarray, np.ndarray, float]:
    """Joints (frame, joint, 3) in metres with y up and the ground at 0, the heading, and the height. People differ."""
    height = generator.uniform(1.5, 1.95)
    upper, fore, thigh, shank = height * np.array([0.16, 0.146, 0.245, 0.246]) * np.exp(0.04 * generator.normal(size=4))
    trunk, shoulders, hips, foot = height * np.array([0.288, 0.2, 0.11, 0.15])
    time = np.arange(count) / FPS
    wide, deep = reach * generator.uniform(0.6, 1.2, 2)
    around = 1.1 / max(np.hypot(wide, deep) / np.sqrt(2), 0.1) * time + generator.uniform(0, 6.28)
    place = np.stack([wide * np.cos(around), 0 * time, deep * np.sin(around)], 1)
    heading = np.arctan2(*np.gradient(place, axis=0)[:, [0, 2]].T)
    gait = 2 * np.pi * 0.9 * time + generator.uniform(0, 6.28)
    body = Rotation.from_euler(
        "yxz", np.stack([heading + 0.08 * np.sin(gait), 0 * time + 0.08, 0.03 * np.sin(gait)], 1)
    )
    down, found = np.tile([0.0, -1.0, 0.0], (count, 1)), {}
    for side, sign, phase in (("l", 1, 0.0), ("r", -1, np.pi)):
        swing = 0.1 + 0.42 * np.sin(gait + phase)
        bend = 0.25 + 0.5 * np.maximum(0, np.sin(gait + phase + 1.2)) ** 2
        hip = body.apply([sign * hips / 2, 0, 0])
        knee = hip + thigh * (body * _bent(-swing)).apply(down)
        leg = body * _bent(bend - swing)
        ankle = knee + shank * leg.apply(down)
        heel = ankle + leg.apply([0, -0.04 * height, -0.03 * height])
        shoulder = body.apply([sign * shoulders / 2, trunk, 0])
        raised = 0.15 + 0.25 * np.maximum(0, np.sin(0.9 * time + 2 * sign))
        arm = 0.35 * np.sin(gait + phase + np.pi) + 0.25 * np.sin(1.3 * time + sign)
        arm = body * Rotation.from_euler("zx", np.stack([sign * raised, -arm], 1))
        elbow = shoulder + upper * arm.apply(down)
        bent = _bent(-0.4 - 0.4 * (1 + np.sin(1.7 * time + sign)))
        parts = {"hip": hip, "knee": knee, "ankle": ankle, "heel": heel, "shoulder": shoulder, "elbow": elbow}
        parts["big_toe"], parts["wrist"] = heel + leg.apply([0, 0, foot]), elbow + fore * (arm * bent).apply(down)
        parts["ear"] = body.apply([sign * 0.045 * height, trunk + 0.13 * height, 0])
        found |= {f"{side}_{name}": value for name, value in parts.items()}
    found["nose"] = body.apply([0, trunk + 0.11 * height, 0.065 * height])
    joints = np.stack([found[name] for name in JOINTS], axis=1)
    joints[..., 1] -= joints[..., 1].min(axis=1, keepdims=True)
    return joints + place[:, None], heading, height


def detected(
    joints: np.ndarray, heading: np.ndarray, pose: np.ndarray, focal: float, size: tuple[int, int], generator
) -> np.ndarray:
    """BODY_25 points of one camera: joints seen beside themselves by a centimetre that depends on the side that is
    seen, errors that last some frames, legs taken for each other, and points that are elsewhere."""
    count, number = joints.shape[:2]
    inside = joints @ pose[:3, :3].T + pose[:3, 3]
    centre = -pose[:3, :3].T @ pose[:3, 3]
    seen_from = heading - np.arctan2(*(centre - joints.mean(1))[:, [0, 2]].T)
    phases = seen_from[:, None, None] + generator.uniform(0, 6.28, (number, 2))
    inside[..., :2] += 0.011 * generator.normal(size=(number, 2)) * np.cos(phases)
    pixels = focal * inside[..., :2] / inside[..., 2:] + np.array(size) / 2
    extent = np.median(np.ptp(pixels, axis=1).max(-1))
    lasting = generator.normal(size=pixels.shape)
    for frame in range(1, count):
        lasting[frame] = 0.8 * lasting[frame - 1] + 0.6 * lasting[frame]
    pixels += extent * (0.006 * lasting + 0.004 * generator.normal(size=pixels.shape))
    for start in np.flatnonzero(generator.random(count) < 0.01):
        legs = [[JOINTS.index(f"{side}_{name}") for name in ("knee", "ankle", "heel", "big_toe")] for side in "lr"]
        span = slice(start, start + 4)
        pixels[span, legs[0]], pixels[span, legs[1]] = pixels[span, legs[1]].copy(), pixels[span, legs[0]].copy()
    away = generator.random((count, number)) < 0.01
    pixels[away] += 0.1 * extent * generator.normal(size=(int(away.sum()), 2))
    result = np.zeros((count, 25, 3))
    result[:, ROWS, :2], result[:, ROWS, 2] = pixels, 0.9
    outside = ((result[..., :2] < 0) | (result[..., :2] > size)).any(-1)
    result[outside | (generator.random((count, 25)) < 0.04)] = 0.0
    return result


def filmed_walk(seed: int, angles: tuple[float, ...] = (60.0,), count: int = 240, reach: float = 1.0) -> Walk:
    """A walk before cameras that stand so many degrees from the first, with lenses of their own."""
    generator = np.random.default_rng(seed)
    joints, heading, height = walking(generator, count, reach)
    upright = generator.random() < 0.5
    size = (540, 960) if upright else (960, 540)
    poses, focal, keypoints = [], [], []
    first = generator.uniform(0, 360)
    for angle in (0.0, *angles):
        focal.append(960 * generator.uniform(0.74, 1.12))
        away = generator.uniform(0.9, 1.25) * (2 + reach) * focal[-1] / 864 * (1.0 if upright else 1.35)
        turn = np.radians(first + angle)
        centre = np.array([away * np.sin(turn), generator.uniform(0.8, 1.8), away * np.cos(turn)])
        target = np.array([0, 0.85, 0]) + 0.1 * generator.normal(size=3)
        poses.append(look(centre, target, np.radians(1.5) * generator.normal()))
        keypoints.append(detected(joints, heading, poses[-1], focal[-1], size, generator))
    return Walk(np.array(keypoints), np.array(poses), np.array(focal), size, height, joints)
