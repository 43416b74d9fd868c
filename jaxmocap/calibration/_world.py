"""The metric world: from the model's arbitrary scale, axes and origin to metres, up, and an origin under the person."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxmocap.geometry import fit_similarity

from ._gravity import Gravity
from ._trajectory import camera_centres

_ANKLE_HEIGHT = 0.08  # metres above the ground
_EYE_HEIGHT = 1.5  # of a camera held up, where nothing tells the ground


class WorldFromModel(NamedTuple):
    """x_world = scale * rotation @ x_model + translation."""

    scale: float
    rotation: Float[np.ndarray, "3 3"]
    translation: Float[np.ndarray, "3"]

    def points(self, points: Float[np.ndarray, "*shape 3"]) -> Float[np.ndarray, "*shape 3"]:
        return self.scale * points @ self.rotation.T + self.translation

    def poses(self, cam_from_model: Float[np.ndarray, "*shape 4 4"]) -> Float[np.ndarray, "*shape 4 4"]:
        """cam_from_world of cameras in the scaled world."""
        result = np.array(cam_from_model, np.float64)
        result[..., :3, :3] = cam_from_model[..., :3, :3] @ self.rotation.T
        result[..., :3, 3] = self.scale * cam_from_model[..., :3, 3] - result[..., :3, :3] @ self.translation
        return result


def same_world(before: Float[np.ndarray, "point 3"], after: Float[np.ndarray, "point 3"]) -> WorldFromModel:
    """The similarity that brings points back to where they were (Umeyama 1991), without those that moved by themselves:
    what an adjustment without fixed points adds to its answer."""
    kept = np.ones(len(before), bool)
    for _ in range(5):
        back = fit_similarity(after[kept], before[kept])
        found = WorldFromModel(back.scale, back.rotation, back.translation)
        away = np.linalg.norm(found.points(after) - before, axis=1)
        kept = away <= 3 * np.median(away) + 1e-12
    return found


def world_from_model(
    cam_from_model: Float[np.ndarray, "pose 4 4"],
    metres_per_unit: float,
    gravity: Gravity,
    up_axis: str,
    subject: Float[np.ndarray, "point 3"],
    ankles: Float[np.ndarray, "ankle 3"],
) -> WorldFromModel:
    """Metres, `up_axis` ("y" or "z") up, the origin on the ground under the `subject` points' median, the first pose's
    camera on the side of +z (y up) or -y (z up). `ankles` give the ground where the model has no plane for it."""
    up = gravity.up / np.linalg.norm(gravity.up)
    middle = np.median(subject, axis=0)
    towards = camera_centres(cam_from_model[:1])[0] - middle
    towards = towards - (towards @ up) * up
    if np.linalg.norm(towards) < 1e-9:
        towards = np.eye(3)[np.abs(up).argmin()] - up * up[np.abs(up).argmin()]
    towards = towards / np.linalg.norm(towards)
    across = np.cross(up, towards)
    rotation = np.stack([across, up, towards] if up_axis == "y" else [across, -towards, up])
    if gravity.ground is not None:
        normal, offset = gravity.ground.normal, gravity.ground.offset
        height = float(middle @ up + (offset - normal @ middle) / (normal @ up))  # of the ground below the person
    elif len(ankles):
        height = float((ankles @ up).min()) - _ANKLE_HEIGHT / metres_per_unit
    else:
        height = float(np.median(camera_centres(cam_from_model) @ up)) - _EYE_HEIGHT / metres_per_unit
    origin = middle + (height - middle @ up) * up
    return WorldFromModel(metres_per_unit, rotation, -metres_per_unit * rotation @ origin)
