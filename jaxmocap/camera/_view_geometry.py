"""Where cameras stand: angles between them at the person, the error of one pixel there, what they look at, and up."""

from itertools import combinations
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxmocap.geometry import camera_centres


class ViewGeometry(NamedTuple):
    """How well cameras see a point, the person, that every camera sees with one pixel of error.

    Attributes:
        angle: the largest between the directions to two cameras, degrees.
        across: standard deviation of the point in its most certain direction, metres.
        depth: the same in its least certain direction.
    """

    angle: float
    across: float
    depth: float

    @property
    def ratio(self) -> float:
        """How many times worse depth is than position across the view."""
        return self.depth / self.across


def view_geometry(
    focal: Float[np.ndarray, " camera"],
    cam_from_world: Float[np.ndarray, "camera 4 4"],
    subject: Float[np.ndarray, "3"],
) -> ViewGeometry:
    """Measure the geometry at one instant; depth is infinite for cameras in one line with the person."""
    rays = subject - camera_centres(cam_from_world)
    distances = np.linalg.norm(rays, axis=1)
    rays = rays / distances[:, None]
    angles = [np.degrees(np.arccos(np.clip(a @ b, -1, 1))) for a, b in combinations(rays, 2)]
    per_pixel = focal / distances
    information = np.einsum("c,cij->ij", per_pixel**2, np.eye(3) - rays[:, :, None] * rays[:, None, :])
    values = np.linalg.eigvalsh(information)
    worst = 1 / np.sqrt(values[0]) if values[0] > 1e-9 * values[-1] else np.inf
    return ViewGeometry(float(max(angles, default=0.0)), float(1 / np.sqrt(values[-1])), float(worst))


def describe_views(geometry: ViewGeometry) -> str:
    """Say what the angle means, in words."""
    if not np.isfinite(geometry.depth):
        return "the cameras see the person from one direction only: depth cannot be measured; place them apart."
    advice = (
        "place them 30 to 90 degrees apart"
        if geometry.angle < 15
        else "more angle would help depth"
        if geometry.angle < 30
        else "a good angle"
    )
    return (
        f"the cameras see the person from directions {geometry.angle:.0f} degrees apart: a pixel of error is "
        f"{100 * geometry.across:.1f} cm across and {100 * geometry.depth:.1f} cm in depth ({geometry.ratio:.1f} times "
        f"as much; two cameras 50 degrees apart have 2.4 times, 5 degrees apart 23 times): {advice}."
    )


def look_at_point(cam_from_world: Float[np.ndarray, "pose 4 4"]) -> Float[np.ndarray, "3"]:
    """Find the point nearest to all optical axes: where the person is when keypoints do not tell."""
    axes, centres = cam_from_world[:, 2, :3], camera_centres(cam_from_world)
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    return np.linalg.lstsq(across.sum(0), np.einsum("nij,nj->i", across, centres), rcond=None)[0]


def view_angles(
    cam_from_world: Float[np.ndarray, "camera 4 4"], point: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "camera camera"]:
    """Measure the degrees between the directions in which two cameras stand, seen from a point."""
    rays = camera_centres(cam_from_world) - point
    towards = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    return np.degrees(np.arccos(np.clip(towards @ towards.T, -1.0, 1.0)))


def world_from_upright(cam_from_world: Float[np.ndarray, "camera 4 4"]) -> Float[np.ndarray, "3 3"]:
    """Find the rotation from a world whose y points to where the cameras' upper edges do in the mean; its x is any."""
    up = -cam_from_world[:, 1, :3].mean(0)
    up = up / np.linalg.norm(up)
    side = np.cross(up, np.eye(3)[np.argmin(np.abs(up))])
    side = side / np.linalg.norm(side)
    return np.stack([side, up, np.cross(side, up)], axis=1)
