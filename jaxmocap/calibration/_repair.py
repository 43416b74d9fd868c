"""Every frame gets a pose on its camera's path: those that left it are placed again, else interpolated."""

from dataclasses import dataclass, field

import numpy as np

from jaxmocap._results import InputError
from jaxmocap.geometry import camera_centres

from ._footage import Report
from ._mapping import median_depth
from ._matching import Place
from ._registration import Model, Sightings
from ._trajectory import Departures, find_outliers, interpolate

_AROUND = 20  # frames on either side
_STILL = 0.01  # of the distance to the scene


@dataclass
class Repairs:
    """What was done to the poses.

    Attributes:
        outliers: frames whose poses were off the path.
        placed_again: of these, and of frames never placed, those placed by what they see.
        interpolated: those placed between their neighbours.
    """

    outliers: list[Place] = field(default_factory=list)
    placed_again: list[Place] = field(default_factory=list)
    interpolated: list[Place] = field(default_factory=list)


def path_of(model: Model, camera: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """List a camera's frame numbers, poses (identity where unknown) and which are known."""
    frames = list(model.footage.videos[camera].frames)
    poses = [model.pose((camera, frame)) for frame in frames]
    known = np.array([pose is not None for pose in poses])
    return np.array(frames, float), np.stack([np.eye(4) if p is None else p for p in poses]), known


def remove_outliers(model: Model) -> list[Place]:
    """Take poses off their camera's path out of the model; return their places."""
    distance = median_depth(model.reconstruction)
    removed = []
    for camera in range(len(model.footage.videos)):
        frames, poses, known = path_of(model, camera)
        off = find_outliers(frames[known], poses[known], distance).outlier
        removed += [(camera, int(frame)) for frame in frames[known][off]]
    for place in removed:
        model.remove(place)
    return removed


def repair(model: Model, sightings: dict[Place, Sightings], report: Report) -> Repairs:
    """Give every frame a pose on its camera's path; `sightings` are those of the frames between the key frames."""
    repairs = Repairs(outliers=remove_outliers(model))
    missing = [
        (camera, frame)
        for camera, video in enumerate(model.footage.videos)
        for frame in video.frames
        if model.pose((camera, frame)) is None
    ]
    distance = median_depth(model.reconstruction)
    for number, place in enumerate(missing, start=1):
        camera, frame = place
        frames, poses, known = path_of(model, camera)
        predicted = interpolate(frames, poses, known)
        seen = sightings.get(place) or _again(model, place)
        found = None if seen is None else model.place(camera, seen, predicted[int(frame - frames[0])])
        if found is not None:
            model.add(place, found)
            if _is_off(model, place, distance):
                model.remove(place)
                found = None
        if found is not None:
            repairs.placed_again.append(place)
        report("repairing poses", number, len(missing))
    for camera in range(len(model.footage.videos)):
        frames, poses, known = path_of(model, camera)
        filled = interpolate(frames, poses, known)
        for index in np.flatnonzero(~known):
            place = camera, int(frames[index])
            model.add_without_points(place, filled[index])
            repairs.interpolated.append(place)
    return repairs


def _again(model: Model, place: Place) -> Sightings | None:
    features = model.features.get(place)
    return None if features is None else model.sightings(place, features)


def _is_off(model: Model, place: Place, distance: float) -> bool:
    """Whether a pose leaves the path of the poses around it."""
    frames, poses, known = path_of(model, place[0])
    near = known & (np.abs(frames - place[1]) <= _AROUND)
    return bool(find_outliers(frames[near], poses[near], distance).outlier[frames[near] == place[1]].any())


def departures(model: Model, camera: int) -> Departures:
    """Compare each pose of a camera's finished path with its neighbours."""
    frames, poses, _ = path_of(model, camera)
    return find_outliers(frames, poses, median_depth(model.reconstruction))


def refuse_motionless(model: Model) -> None:
    """Raise `InputError` where two cameras did not move and their focal length is unknown.

    Two places alone do not tell the focal length, since the optical axes meet at the person.
    """
    if model.footage.focal_known or len(model.footage.videos) > 2:
        return
    distance = median_depth(model.reconstruction)
    moved = []
    for camera in range(len(model.footage.videos)):
        _, poses, known = path_of(model, camera)
        centres = camera_centres(poses[known])
        moved.append(float(np.linalg.norm(centres - np.median(centres, axis=0), axis=1).max()))
    if max(moved) < _STILL * distance:
        names = " and ".join(f"'{video.name}'" for video in model.footage.videos)
        raise InputError(
            f"camera{'s' * (len(moved) > 1)} {names} did not move: {100 * max(moved) / distance:.1f} % of the distance "
            "to the scene, at least 1 % is needed to find the focal length; walk a step while filming, or give the "
            "focal length with --focal."
        )
