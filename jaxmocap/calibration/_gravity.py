"""Which way is up: from how people hold phones, from the ground, and from how the person stands."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxmocap.capture import KEYPOINT_NAMES

_LEAST_YAW = 0.08  # second singular value of the cameras' x axes relative to the first: about 10 degrees of yaw
_PLANE_TILT = np.radians(5.0)
_PLANE_WIDTH = 0.006  # of the distance to the scene
_PLANE_POINTS = 200
_SAME = np.radians(3.0)


class Plane(NamedTuple):
    """Points p with normal @ p = offset, the normal pointing up, and how many points of the model lie on it."""

    normal: Float[np.ndarray, "3"]
    offset: float
    count: int


class Gravity(NamedTuple):
    """Up as a unit vector of the model's world; where it comes from; the ground, where there is one; angles (degrees)
    between it and what the other cues say; sentences about cues that differ."""

    up: Float[np.ndarray, "3"]
    source: str
    ground: Plane | None
    differences: dict[str, float]
    warnings: tuple[str, ...]


def up_from_cameras(cam_from_world: Float[np.ndarray, "pose 4 4"]) -> Float[np.ndarray, "3"]:
    """The direction at right angles to all cameras' x axes, for people hold phones level but look down; where all look
    the same way, the part of the mean image-up that is at right angles to the mean x axis."""
    across, up = cam_from_world[:, 0, :3], -cam_from_world[:, 1, :3].mean(0)
    _, values, vectors = np.linalg.svd(across, full_matrices=False)
    if values[1] > _LEAST_YAW * values[0]:
        found = vectors[2]
    else:
        found = up - (up @ vectors[0]) * vectors[0]
    found = found if found @ up > 0 else -found
    return found / np.linalg.norm(found)


def ground_plane(
    points: Float[np.ndarray, "point 3"],
    centres: Float[np.ndarray, "pose 3"],
    up: Float[np.ndarray, "3"],
    distance: float,
    seed: int = 0,
) -> Plane | None:
    """The plane of most points, of those within 5 degrees of level and below the cameras; None below 200 points."""
    below = points[points @ up < (centres @ up).min() - 0.1 * distance]
    if len(below) < _PLANE_POINTS:
        return None
    generator = np.random.default_rng(seed)
    best: np.ndarray | None = None
    for _ in range(600):
        a, b, c = below[generator.choice(len(below), 3, replace=False)]
        normal = np.cross(b - a, c - a)
        length = np.linalg.norm(normal)
        if length == 0 or abs(normal @ up) < np.cos(_PLANE_TILT) * length:
            continue
        on = np.abs((below - a) @ normal) < _PLANE_WIDTH * distance * length
        if best is None or on.sum() > best.sum():
            best = on
    if best is None or best.sum() < _PLANE_POINTS:
        return None
    middle, normal = below[best].mean(0), up
    for _ in range(5):  # total least squares with its own points
        middle = below[best].mean(0)
        normal = np.linalg.svd(below[best] - middle, full_matrices=False)[2][2]
        best = np.abs((below - middle) @ normal) < _PLANE_WIDTH * distance
        if best.sum() < _PLANE_POINTS:
            return None
    normal = normal if normal @ up > 0 else -normal
    return Plane(normal, float(normal @ middle), int(best.sum())) if normal @ up > np.cos(_PLANE_TILT) else None


def up_from_person(people: Sequence[Float[np.ndarray, "25 3"]]) -> Float[np.ndarray, "3"] | None:
    """Mean direction from between the ankles to the neck; None where these were not seen."""
    neck, left, right = (KEYPOINT_NAMES.index(name) for name in ("neck", "l_ankle", "r_ankle"))
    directions = [points[neck] - 0.5 * (points[left] + points[right]) for points in people]
    directions = [d / np.linalg.norm(d) for d in directions if np.isfinite(d).all()]
    if not directions:
        return None
    mean = np.mean(directions, axis=0)
    return mean / np.linalg.norm(mean)


def find_gravity(
    cam_from_world: Float[np.ndarray, "pose 4 4"],
    points: Float[np.ndarray, "point 3"],
    distance: float,
    people: Sequence[Float[np.ndarray, "25 3"]] = (),
    given: Float[np.ndarray, "3"] | None = None,
) -> Gravity:
    """Up, by the best cue there is: given by hand; else the ground, a plane near level; else the cameras. The person
    only checks, since people lean. `given` is in the model's world."""
    centres = -np.einsum("nji,nj->ni", cam_from_world[:, :3, :3], cam_from_world[:, :3, 3])
    cameras = up_from_cameras(cam_from_world)
    start = cameras if given is None else given / np.linalg.norm(given)
    ground = ground_plane(points, centres, start, distance)
    person = up_from_person(people)
    cues = {"cameras": cameras, "ground": None if ground is None else ground.normal, "person": person, "given": given}
    source = "given" if given is not None else "ground" if ground is not None else "cameras"
    up = start if ground is None or given is not None else ground.normal
    differences = {
        name: float(np.degrees(np.arccos(np.clip(cue @ up / np.linalg.norm(cue), -1, 1))))
        for name, cue in cues.items()
        if cue is not None and name != source
    }
    limits = {"cameras": _SAME, "ground": _SAME, "person": np.radians(25.0)}
    warnings = tuple(
        f"up is taken from the {source}, but the {name} would have it {angle:.0f} degrees elsewhere: if the result "
        "leans, give it with --up"
        for name, angle in differences.items()
        if angle > np.degrees(limits[name])
    )
    return Gravity(up, source, ground, differences, warnings)
