"""Two hand-held cameras around a person on a square, with everything known."""

import numpy as np
from scipy.spatial.transform import Rotation

FOCAL = 900.0
MATRIX = np.array([[FOCAL, 0.0, 480.0], [0.0, FOCAL, 270.0], [0.0, 0.0, 1.0]])


def look(centre: np.ndarray, target: np.ndarray, roll: float = 0.0) -> np.ndarray:
    """cam_from_world of a level camera at `centre` that looks at `target`; y is up in the world. Roll in radians."""
    forward = (target - centre) / np.linalg.norm(target - centre)
    across = np.cross(forward, [0.0, 1.0, 0.0])
    across /= np.linalg.norm(across)
    rotation = Rotation.from_rotvec([0, 0, roll]).as_matrix() @ np.stack([across, np.cross(forward, across), forward])
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, -rotation @ centre
    return pose


def paths(count: int = 40, seed: int = 0) -> np.ndarray:
    """cam_from_world (2, count, 4, 4): a step to the side with the shake of a hand, looking at the person's chest."""
    generator = np.random.default_rng(seed)
    t = np.linspace(0, 1, count)
    poses = []
    for start, end in (([0.6, 1.5, 4.0], [0.2, 1.5, 4.1]), ([-1.8, 1.4, 3.8], [-1.4, 1.3, 4.0])):
        centres = np.array(start) * (1 - t[:, None]) + np.array(end) * t[:, None]
        centres += 0.01 * np.stack([np.sin(2 * np.pi * (2 * t + phase)) for phase in generator.random(3)], 1)
        centres += 0.001 * generator.normal(size=centres.shape)
        rolls = np.radians(0.5) * np.sin(2 * np.pi * 3 * t) + np.radians(0.05) * generator.normal(size=count)
        poses.append([look(c, np.array([0.0, 1.0, 0.0]), roll) for c, roll in zip(centres, rolls, strict=True)])
    return np.array(poses)


def centres_of(poses: np.ndarray) -> np.ndarray:
    return -np.einsum("...ji,...j->...i", poses[..., :3, :3], poses[..., :3, 3])


def project(pose: np.ndarray, points: np.ndarray) -> np.ndarray:
    image = (points @ pose[:3, :3].T + pose[:3, 3]) @ MATRIX.T
    return image[:, :2] / image[:, 2:]


def moved_world(poses: np.ndarray, scale: float, rotation: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """The same cameras in a world x' = scale R x + shift, as structure from motion would give them."""
    result = poses.copy()
    result[..., :3, :3] = poses[..., :3, :3] @ rotation.T
    result[..., :3, 3] = scale * poses[..., :3, 3] - result[..., :3, :3] @ shift
    return result
