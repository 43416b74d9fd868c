"""Models that look finished but cannot be true, because the cameras did not move."""

import numpy as np

from jaxmocap._results import InputError

from ._adjust import median_depth
from ._registration import Model
from ._repair import path_of
from ._trajectory import camera_centres

_STILL = 0.01  # of the distance to the scene


def refuse_motionless(model: Model) -> None:
    """Two places alone do not tell the focal length (the optical axes meet at the person), so unless it is known one
    camera at least must have moved. Raises `InputError`."""
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
