"""Two or three people filming: handheld cameras on an arc before the actor."""

import numpy as np
from jaxtyping import Float

FOCAL_PER_WIDTH = 0.95
VIEW_ANGLE = np.radians(27.0)
BODY_FRACTION = 0.75


def intrinsics_of(size: tuple[int, int], focal_per_width: float = FOCAL_PER_WIDTH) -> Float[np.ndarray, "3 3"]:
    """Make pinhole intrinsics of an image of (width, height)."""
    width, height = size
    focal = focal_per_width * width
    return np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1.0]])


def filming_distance(
    size: tuple[int, int],
    actor_height: float = 1.75,
    focal_per_width: float = FOCAL_PER_WIDTH,
    body_fraction: float = BODY_FRACTION,
) -> float:
    """Compute from how far (metres) an actor fills a fraction of the height of an image of (width, height)."""
    return focal_per_width * size[0] * actor_height / (body_fraction * size[1])


def handheld_paths(
    times: Float[np.ndarray, "frame"],
    targets: Float[np.ndarray, "frame 3"],
    distance: float,
    num_cameras: int = 2,
    seed: int = 0,
    shake: float = 1.0,
    actor_height: float = 1.75,
    view_angle: float = VIEW_ANGLE,
) -> Float[np.ndarray, "camera frame 4 4"]:
    """Make cam_from_world of cameras `view_angle` radians apart on an arc around the actor (`filming_distance`).

    `targets` are the actor's places on the ground, which the aim follows. `shake` scales the hands: a drift of
    decimetres, trembling of a few centimetres and about 1 degree; 0 gives tripods that only turn. A path is a function
    of time, so any times may be asked for.
    """
    times = np.asarray(times, float)
    poses = []
    for camera in range(num_cameras):
        rng = np.random.default_rng([seed, 3, camera])
        azimuth = (camera - 0.5 * (num_cameras - 1)) * view_angle
        drift = np.stack([_band(rng, times, 0.05, 0.25, a) for a in (0.12, 0.04, 0.10)], axis=1)
        tremble = np.stack([_band(rng, times, 0.8, 3.0, 0.012) for _ in range(3)], axis=1)
        turn = np.stack([_band(rng, times, 0.4, 2.5, np.radians(a)) for a in (0.6, 0.6, 0.8)], axis=1)
        stand = np.array([distance * np.sin(azimuth), 1.38 + 0.1 * (camera % 2), distance * np.cos(azimuth)])
        centre = stand + shake * (drift + tremble) + 0.25 * targets
        aim = 0.85 * targets + np.array([0.0, 0.57 * actor_height, 0.0])
        poses.append(_look_at(centre, aim, shake * turn))
    return np.stack(poses)


def _band(rng: np.random.Generator, times: np.ndarray, low: float, high: float, strength: float) -> np.ndarray:
    """Draw smooth noise whose frequencies (Hz) lie between two bounds; `strength` is its standard deviation."""
    waves = 8
    rates, phases = rng.uniform(low, high, waves), rng.uniform(0, 2 * np.pi, waves)
    return strength * np.sqrt(2 / waves) * np.sin(2 * np.pi * rates * times[:, None] + phases).sum(axis=1)


def _look_at(centre: np.ndarray, aim: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """Look from centres (T, 3) at aims, then turn poses (T, 4, 4) about their own axes by small angles (T, 3)."""
    forward = aim - centre
    forward /= np.linalg.norm(forward, axis=1, keepdims=True)
    right = np.cross(forward, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    rotation = np.stack([right, np.cross(forward, right), forward], axis=1)
    rotation = _rotation_from_vector(turn) @ rotation
    poses = np.tile(np.eye(4), (len(centre), 1, 1))
    poses[:, :3, :3] = rotation
    poses[:, :3, 3] = -np.einsum("tij,tj->ti", rotation, centre)
    return poses


def _rotation_from_vector(vectors: np.ndarray) -> np.ndarray:
    angle = np.linalg.norm(vectors, axis=1)[:, None, None]
    unit = vectors / np.maximum(angle[:, :, 0], 1e-12)
    cross = np.cross(np.eye(3)[None], unit[:, None, :])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
