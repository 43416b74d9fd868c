"""The metric world: which way is up, and from the model's arbitrary scale, axes and origin to metres."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxmocap.capture import KEYPOINT_NAMES
from jaxmocap.geometry import Similarity, camera_centres, fit_similarity

_LEAST_YAW = 0.08  # second singular value of the cameras' x axes relative to the first: about 10 degrees of yaw
_PLANE_TILT = np.radians(5.0)
_PLANE_WIDTH = 0.006  # of the distance to the scene
_PLANE_POINTS = 200
_SAME = np.radians(3.0)  # cues that differ by less agree
_ANKLE_HEIGHT = 0.08  # metres above the ground
_EYE_HEIGHT = 1.5  # of a camera held up, where nothing tells the ground


class Plane(NamedTuple):
    """The ground: points p with normal @ p = offset.

    Attributes:
        normal: unit vector, pointing up.
        offset: along the normal, in the model's units.
        count: how many points of the model lie on it.
    """

    normal: Float[np.ndarray, "3"]
    offset: float
    count: int


class Gravity(NamedTuple):
    """Which way is up.

    Attributes:
        up: unit vector of the model's world.
        source: the cue it is from: "given", "ground" or "cameras".
        ground: the plane, where there is one.
        differences: angles between it and what the other cues say, degrees.
        warnings: sentences about cues that differ.
    """

    up: Float[np.ndarray, "3"]
    source: str
    ground: Plane | None
    differences: dict[str, float]
    warnings: tuple[str, ...]


def up_from_cameras(cam_from_world: Float[np.ndarray, "pose 4 4"]) -> Float[np.ndarray, "3"]:
    """Find the direction at right angles to all cameras' x axes, for people hold phones level but look down.

    Where all look the same way, it is the part of the mean image-up that is at right angles to the mean x axis.
    """
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
    """Find the plane of most points, within 5 degrees of level and below the cameras (RANSAC); None below 200."""
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
    """Average the direction from between the ankles to the neck; None where these were not seen."""
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
    """Find up by the best cue there is: `given` by hand, else the ground, a plane near level, else the cameras.

    The person only checks, since people lean. `given` is in the model's world.
    """
    cameras = up_from_cameras(cam_from_world)
    start = cameras if given is None else given / np.linalg.norm(given)
    ground = ground_plane(points, camera_centres(cam_from_world), start, distance)
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


def same_world(before: Float[np.ndarray, "point 3"], after: Float[np.ndarray, "point 3"]) -> Similarity:
    """Find the similarity that brings points back to where they were (Umeyama 1991): what an adjustment without fixed
    points adds to its answer. Points that moved by themselves do not count."""
    kept = np.ones(len(before), bool)
    for _ in range(5):
        found = fit_similarity(after[kept], before[kept])
        away = np.linalg.norm(found(after) - before, axis=1)
        kept = away <= 3 * np.median(away) + 1e-12
    return found


def world_from_model(
    cam_from_model: Float[np.ndarray, "pose 4 4"],
    metres_per_unit: float,
    gravity: Gravity,
    up_axis: str,
    subject: Float[np.ndarray, "point 3"],
    ankles: Float[np.ndarray, "ankle 3"],
) -> Similarity:
    """Find metric_world_from_model: metres, `up_axis` ("x", "y" or "z") up, the origin on the ground under the person.

    The person is the median of the `subject` points; the first pose's camera stands on the side of +z (x or y up) or
    -y (z up). `ankles` give the ground where the model has no plane for it.
    """
    up = gravity.up / np.linalg.norm(gravity.up)
    middle = np.median(subject, axis=0)
    towards = camera_centres(cam_from_model[:1])[0] - middle
    towards = towards - (towards @ up) * up
    if np.linalg.norm(towards) < 1e-9:
        towards = np.eye(3)[np.abs(up).argmin()] - up * up[np.abs(up).argmin()]
    towards = towards / np.linalg.norm(towards)
    across = np.cross(up, towards)
    axes = {"x": (up, -across, towards), "y": (across, up, towards), "z": (across, -towards, up)}
    rotation = np.stack(axes[up_axis])
    if gravity.ground is not None:
        normal, offset = gravity.ground.normal, gravity.ground.offset
        height = float(middle @ up + (offset - normal @ middle) / (normal @ up))  # of the ground below the person
    elif len(ankles):
        height = float((ankles @ up).min()) - _ANKLE_HEIGHT / metres_per_unit
    else:
        height = float(np.median(camera_centres(cam_from_model) @ up)) - _EYE_HEIGHT / metres_per_unit
    origin = middle + (height - middle @ up) * up
    return Similarity(metres_per_unit, rotation, -metres_per_unit * rotation @ origin)
