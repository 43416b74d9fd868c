"""From where a scene is looked at first: from outside, the person, the ground and the cameras in the picture, and no
camera before the person."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from jaxmocap.geometry import unit

FIELD_OF_VIEW = 0.9  # radians, vertical
_ELEVATIONS = np.radians([12.0, 25.0, 40.0])
_AZIMUTHS = np.radians(np.arange(0.0, 360.0, 10.0))
_MARGIN = 1.12  # air around what is to be seen
_FRUSTUM = 0.1  # longest side of a camera's frustum over the scene's
_BEFORE = 0.5  # what a place is worth from which a camera covers part of the person


@dataclass(frozen=True)
class Eye:
    """Where one looks from, and at what, in the world's metres; `up` has length 1."""

    position: Float[np.ndarray, "3"]
    target: Float[np.ndarray, "3"]
    up: Float[np.ndarray, "3"]

    def cam_from_world(self) -> Float[np.ndarray, "4 4"]:
        """Build the pose of a camera there: x right, y down, z forward."""
        forward = unit(self.target - self.position)
        right = unit(np.cross(forward, self.up))
        rotation = np.stack([right, np.cross(forward, right), forward])
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = rotation, -rotation @ self.position
        return pose


def frustum_size(people: Float[np.ndarray, "point 3"], centres: Float[np.ndarray, "camera 3"]) -> float:
    """Compute how long the longest side of a drawn frustum is: a tenth of the scene's, metres."""
    points = np.concatenate([people, centres])
    return _FRUSTUM * float((points.max(axis=0) - points.min(axis=0)).max())


def first_view(
    people: Float[np.ndarray, "point 3"],
    frusta: Float[np.ndarray, "camera corner 3"],
    axis: int,
    aspect: float,
    field_of_view: float = FIELD_OF_VIEW,
) -> Eye:
    """Choose where to look from first, among places all round at three heights.

    Everything is in the picture from there; the person is as large as can be, and no frustum before the person.
    `people` are points of the person or persons with the ground under them, `frusta` the corners of every camera's
    frustum (none is fine), `axis` is the vertical one and `aspect` the picture's width over its height.
    """
    up = np.eye(3)[axis]
    points = np.concatenate([people, frusta.reshape(-1, 3)])
    target = (points.min(axis=0) + points.max(axis=0)) / 2
    best, chosen = -np.inf, None
    for elevation in _ELEVATIONS:
        for azimuth in _AZIMUTHS:
            sides = np.insert([np.cos(azimuth), np.sin(azimuth)], axis, 0.0)
            away = np.cos(elevation) * sides + np.sin(elevation) * up
            eye = Eye(target + away, target, up)
            distance = _MARGIN * distance_from(points, eye, field_of_view, aspect)
            eye = Eye(target + distance * away, target, up)
            worth = _worth(people, frusta, eye)
            if worth > best:
                best, chosen = worth, eye
    assert chosen is not None
    return chosen


def distance_from(points: Float[np.ndarray, "point 3"], eye: Eye, field_of_view: float, aspect: float) -> float:
    """Compute from how far, along an eye's direction, all points are in its picture."""
    seen = (points - eye.target) @ eye.cam_from_world()[:3, :3].T
    tall = np.tan(field_of_view / 2)
    needed = np.maximum(np.abs(seen[:, 0]) / (tall * aspect), np.abs(seen[:, 1]) / tall) - seen[:, 2]
    return float(needed.max())


def _worth(people: np.ndarray, frusta: np.ndarray, eye: Eye) -> float:
    """Tell how high the person looks; less where a frustum lies before them."""
    low, high, depth = _window(people, eye)
    worth = float(high[1] - low[1])
    for corners in frusta:
        first, last, nearest = _window(corners, eye)
        if nearest < depth and (first < high).all() and (last > low).all():
            worth *= _BEFORE
    return worth


def _window(points: np.ndarray, eye: Eye) -> tuple[np.ndarray, np.ndarray, float]:
    """Return the least rectangle round points in the picture, as tangents of angles, and the least depth."""
    pose = eye.cam_from_world()
    seen = points @ pose[:3, :3].T + pose[:3, 3]
    flat = seen[:, :2] / np.maximum(seen[:, 2:], 1e-6)
    return flat.min(axis=0), flat.max(axis=0), float(seen[:, 2].min())
