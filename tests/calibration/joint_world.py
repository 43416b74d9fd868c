"""A body that swings before a background, two walking cameras, and a calibration that is off in known ways."""

from dataclasses import dataclass

import numpy as np
from moving_cameras import FOCAL, paths
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from jaxmocap.calibration._joint_scene import Body, JointScene

RATE = 30.0
TRACKS = 15


@dataclass(frozen=True)
class World:
    """The scene as a calibration believes it, and the truth: poses, how late the second camera's clock is."""

    scene: JointScene
    poses: np.ndarray
    late: float


def body_at(seconds: np.ndarray) -> np.ndarray:
    """Places (time, track, 3): fifteen points that swing by up to 2 m/s about a person's middle."""
    generator = np.random.default_rng(3)
    middle = generator.normal(0, 0.25, (TRACKS, 3)) + [0, 1.0, 0]
    rate, phase = generator.uniform(3, 8, (TRACKS, 3)), generator.uniform(0, 6, (TRACKS, 3))
    return middle + 0.2 * np.sin(rate * np.asarray(seconds)[:, None, None] + phase)


def drift(count: int, turn: float, shift: float, generator: np.random.Generator) -> np.ndarray:
    """Twists that wander slowly, of this size."""
    t = np.linspace(0, 1, count)[:, None]
    wave = sum(np.sin(2 * np.pi * (f * t + generator.random((1, 6)))) for f in (0.3, 0.8)) / np.sqrt(2)
    return wave * np.repeat([turn, shift], 3) / np.sqrt(3) * np.sqrt(2)


def make_world(
    count: int = 60, late: float = 0.012, turn: float = 0.3, shift: float = 0.015, focal: float = 1.01
) -> World:
    """`late` seconds, `turn` degrees and `shift` metres of slow error of the poses, a wrong `focal` length, and noise:
    0.4 pixels on the background, 2 on the body. The tracked body is 2 cm off."""
    generator = np.random.default_rng(0)
    true = paths(count)
    background = generator.uniform([-4, 0, -4], [4, 3, 1], (300, 3))
    seconds = np.arange(count) / RATE
    start = body_at(seconds).reshape(-1, 3)
    sightings = []
    for camera in range(2):
        for frame in range(count):
            pose = true[camera, frame]
            body = body_at(seconds[frame : frame + 1] + late * camera)[0]
            for points, first, noise in ((body, frame * TRACKS, 2.0), (background, len(start), 0.4)):
                inside = points @ pose[:3, :3].T + pose[:3, 3]
                image = FOCAL * inside[:, :2] / inside[:, 2:] + [480, 270]
                seen = (inside[:, 2] > 0.5) & (image > 0).all(1) & (image < [960, 540]).all(1)
                image = image + generator.normal(0, noise, image.shape)
                rows = np.flatnonzero(seen)
                place = np.full(len(rows), camera * count + frame)
                sightings.append(np.column_stack([place, first + rows, image[rows], np.full(len(rows), noise)]))
    table = np.concatenate(sightings)
    wrong = np.concatenate([drift(count, np.radians(turn), shift, generator) for _ in range(2)])
    poses = true.reshape(-1, 4, 4).copy()
    poses[:, :3] = Rotation.from_rotvec(wrong[:, :3]).as_matrix() @ poses[:, :3]
    poses[:, :3, 3] += wrong[:, 3:]
    tracked = body_at(seconds) + 0.02 * np.sin(7 * seconds[:, None, None] + generator.uniform(0, 6, (TRACKS, 3)))
    which = np.tile(np.arange(TRACKS), count), np.repeat(seconds, TRACKS)
    scene = JointScene(
        cam_from_world=poses,
        camera=np.repeat([0, 1], count),
        seconds=np.tile(seconds, 2),
        focal=np.full((2, 2), FOCAL * focal),
        centre=np.tile([480.0, 270.0], (2, 1)),
        points=np.concatenate([tracked.reshape(-1, 3), background + generator.normal(0, 0.03, background.shape)]),
        body=Body(CubicSpline(seconds, tracked), seconds[0], seconds[-1], *which),
        pose_of=table[:, 0].astype(int),
        point_of=table[:, 1].astype(int),
        pixels=table[:, 2:4],
        sigma=table[:, 4],
    )
    return World(scene, true.reshape(-1, 4, 4), late)
