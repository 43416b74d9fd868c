"""The visual hull: what could be seen as these silhouettes from everywhere (Laurentini 1994), as a mesh."""

from typing import NamedTuple

import cv2
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, UInt8

from jaxmocap._results import InputError
from jaxmocap.camera import View, pixel_rays, project
from jaxmocap.geometry import face_components, surface_nets

from ._sway import Sway

CHUNK = 1 << 16
"""Points that are looked at in one call."""

COARSE = 0.05
"""Metres between the points of the grid that finds where the person is."""

BORDER = 3
"""Cells of the fine grid around that place."""

SHOWN, FEWEST = 0.5, 3
"""Share of the views that have to show a point of the person, and how many at least: two views that face each other
would leave all that lies between their cameras and the person."""

AROUND = 0.75
"""Half the side of the cube in which the person is looked for, as a share of the largest silhouette's diagonal."""


class Views(NamedTuple):
    """Pictures of one person, standing still, from all around (host).

    Attributes:
        grey: pictures of one size without distortion.
        masks: the person's pixels in them.
        intrinsics: K, pixels; the centre of the first pixel is (0.5, 0.5).
        cam_from_world: poses, metres.
        pictures: the same in colour, RGB, at whatever size; None where nobody asks for colours.
        sway: how the person moves from view to view, where that is known.
    """

    grey: UInt8[np.ndarray, "view height width"]
    masks: Bool[np.ndarray, "view height width"]
    intrinsics: Float[np.ndarray, "view 3 3"]
    cam_from_world: Float[np.ndarray, "view 4 4"]
    pictures: UInt8[np.ndarray, "view h w 3"] | None = None
    sway: Sway | None = None

    def only(self, chosen: Bool[np.ndarray, " view"]) -> "Views":
        """Take some of the views."""
        pictures = None if self.pictures is None else self.pictures[chosen]
        sway = None if self.sway is None else self.sway.only(chosen)
        poses = self.intrinsics[chosen], self.cam_from_world[chosen]
        return Views(self.grey[chosen], self.masks[chosen], *poses, pictures, sway)

    def placed(self, points: Float[np.ndarray, "point 3"]) -> list[Float[np.ndarray, "point 3"]]:
        """Place points of the mean body where they are in each view."""
        return [points] * len(self.grey) if self.sway is None else list(points + self.sway.moves(points))

    @property
    def cameras(self) -> View:
        """The cameras on the device."""
        return View(*jax.device_put((self.intrinsics.astype(np.float32), self.cam_from_world.astype(np.float32))))


def mask_distances(masks: Bool[np.ndarray, "view height width"]) -> Float[np.ndarray, "view height width"]:
    """Measure how many pixels the centre of each pixel lies inside the mask's outline; negative outside."""

    def signed(mask: Bool[np.ndarray, "height width"]) -> Float[np.ndarray, "height width"]:
        both = (cv2.distanceTransform(side.astype(np.uint8), cv2.DIST_L2, 5) for side in (mask, ~mask))
        inside, outside = (np.minimum(side, sum(mask.shape)) for side in both)
        return np.where(mask, inside - 0.5, 0.5 - outside).astype(np.float32)

    return np.stack([signed(mask) for mask in masks])


@jax.jit
def cone_depths(
    points: Float[Array, "point 3"],
    distances: Float[Array, "view height width"],
    view: View,
    moves: Float[Array, "view point 3"] | None = None,
) -> Float[Array, "view point"]:
    """Measure by how many metres each point lies inside the cone of each silhouette; negative outside.

    Infinite where a view does not show the point, and so says nothing. `moves` displaces the points in each view.
    """

    def one(camera: tuple[Array, Array, Array, Array | None]) -> Float[Array, " point"]:
        field, intrinsics, cam_from_world, moved = camera
        pixels, depth = project(intrinsics, cam_from_world, points if moved is None else points + moved)
        height, width = field.shape
        column, row = pixels[:, 0] - 0.5, pixels[:, 1] - 0.5
        shown = (depth > 0.05) & (column >= 0) & (row >= 0) & (column <= width - 1) & (row <= height - 1)
        sampled = jax.scipy.ndimage.map_coordinates(field, [row, column], order=1, mode="nearest")
        return jnp.where(shown, sampled * depth / intrinsics[0, 0], jnp.inf)

    return jax.lax.map(one, (distances, view.intrinsics, view.cam_from_world, moves))


def depth_inside(
    points: Float[np.ndarray, "point 3"],
    distances: Float[np.ndarray, "view height width"],
    view: View,
    outliers: int = 0,
    sway: Sway | None = None,
) -> Float[np.ndarray, " point"]:
    """Measure by how many metres points lie inside the visual hull, negative outside (host).

    So many `outliers` among the views may say otherwise. Outside is what two views alone show, or less than half.
    """
    fields, found = jax.device_put(distances), []
    for first in range(0, len(points), CHUNK):
        chosen = points[first : first + CHUNK].astype(np.float32)
        padded = np.pad(chosen, ((0, CHUNK - len(chosen)), (0, 0)), mode="edge")
        moves = None if sway is None else jax.device_put(sway.moves(padded).astype(np.float32))
        depths = np.asarray(cone_depths(jax.device_put(padded), fields, view, moves))[:, : len(chosen)]
        least = np.partition(depths, outliers, axis=0)[outliers]
        shown = np.isfinite(depths).sum(0) >= max(FEWEST, SHOWN * len(distances))
        found.append(np.where(shown & np.isfinite(least), least, -1.0))
    return np.concatenate(found)


def visual_hull(
    views: Views, cell: float = 0.01, outliers: int = 0
) -> tuple[Float[np.ndarray, "vertex 3"], Int[np.ndarray, "face 3"]]:
    """Carve the visual hull on a grid with a point every `cell` metres, and return its largest part as a mesh.

    What is carved is the distance to the nearest silhouette's cone, so that the surface lies between the grid's points.
    Raises `InputError` where the silhouettes have no place in common.
    """
    distances = mask_distances(views.masks)
    low, high = _box(views, distances, outliers)
    low, high = low - BORDER * cell, high + BORDER * cell
    axes = [np.arange(a, b + cell, cell) for a, b in zip(low, high, strict=True)]
    corners = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)

    cameras = views.cameras

    def outside(points: Float[np.ndarray, "point 3"]) -> Float[np.ndarray, " point"]:
        beyond = np.maximum(low - points, points - high).max(1) + cell  # the box closes what the views leave open
        return np.maximum(beyond, -depth_inside(points, distances, cameras, outliers, views.sway))

    vertices, faces = surface_nets(outside, corners, relaxations=2)
    return _largest_part(vertices, faces.astype(np.int64))


def _box(
    views: Views, distances: Float[np.ndarray, "view height width"], outliers: int
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Find the box in the world that holds the hull."""
    middle, size = person_place(views)
    axis = np.arange(-AROUND * size, AROUND * size + COARSE, COARSE)
    points = middle + np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    depths = depth_inside(points, distances, views.cameras, outliers, views.sway)
    if not (depths > 0).any():
        raise InputError(
            "the silhouettes have no place in common: the masks show different people, or the cameras are not those of "
            "the pictures; look at both."
        )
    near = points[depths > -COARSE]
    return near.min(0) - COARSE, near.max(0) + COARSE


def person_place(views: Views) -> tuple[Float[np.ndarray, "3"], float]:
    """Find about where the person stands, and the largest extent that a silhouette has there, in the cameras' unit."""
    cameras, centres, directions, sizes = views.cameras, [], [], []
    for camera, mask in enumerate(views.masks):
        rows, columns = np.nonzero(mask)
        middle = jnp.asarray([[columns.mean() + 0.5, rows.mean() + 0.5]], jnp.float32)
        centre, direction = pixel_rays(cameras.intrinsics[camera], cameras.cam_from_world[camera], middle)
        centres.append(np.asarray(centre, np.float64))
        directions.append(np.asarray(direction, np.float64)[0])
        sizes.append(np.hypot(np.ptp(rows), np.ptp(columns)) / float(views.intrinsics[camera, 0, 0]))
    across = np.eye(3) - np.einsum("vi,vj->vij", directions, directions)
    middle = np.linalg.solve(across.sum(0), np.einsum("vij,vj->i", across, np.array(centres)))
    extents = [size * np.linalg.norm(middle - centre) for size, centre in zip(sizes, centres, strict=True)]
    return middle, float(max(extents))


def _largest_part(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    _, part = face_components(faces)
    used, renumbered = np.unique(faces[part == np.argmax(np.bincount(part))], return_inverse=True)
    return vertices[used], renumbered.reshape(-1, 3)
