"""Which face is seen in each pixel, drawn by the painter's algorithm on the host: quick, and good enough to look at."""

import cv2
import numpy as np
from jaxtyping import Float, Int

_NEAR = 0.05
_SHIFT = 4  # fractional bits of OpenCV's drawing coordinates


def to_pixels(
    points: Float[np.ndarray, "point 3"],
    intrinsics: Float[np.ndarray, "3 3"],
    cam_from_world: Float[np.ndarray, "4 4"],
) -> tuple[Float[np.ndarray, "point 2"], Float[np.ndarray, " point"]]:
    """Pinhole projection in NumPy: pixels (centre of the first at 0.5) and depth, metres. Behind the camera: NaN."""
    in_camera = np.asarray(points, np.float64) @ cam_from_world[:3, :3].T + cam_from_world[:3, 3]
    depth = in_camera[:, 2]
    safe = np.where(depth > _NEAR, depth, np.nan)
    return (in_camera @ intrinsics.T)[:, :2] / safe[:, None], depth


def paint_face_ids(
    vertices: Float[np.ndarray, "vertex 3"],
    faces: Int[np.ndarray, "face 3"],
    intrinsics: Float[np.ndarray, "3 3"],
    cam_from_world: Float[np.ndarray, "4 4"],
    size: tuple[int, int],
) -> Int[np.ndarray, "height width"]:
    """Face numbers (-1 where empty) of an image of `size` (width, height), faces painted from far to near.

    Faces that reach behind the camera are left out. Where faces of a surface interleave in depth the order of their
    centres decides; use `jaxmocap.render.face_ids` for exact visibility.
    """
    pixels, depth = to_pixels(vertices, intrinsics, cam_from_world)
    width, height = size
    corners = pixels[faces]
    low, high = corners.min(axis=1), corners.max(axis=1)  # NaN compares false below
    drawn = (high > 0).all(1) & (low < [width, height]).all(1)
    drawn &= (np.abs(corners) < 2**14).all(axis=(1, 2))
    order = np.flatnonzero(drawn)
    order = order[np.argsort(-depth[faces[order]].mean(axis=1), kind="stable")]
    # OpenCV fills a polygon and its outline, half a pixel too much all round; integer pixel centres, ours are at 0.5.
    quantised = np.round((corners[order] - 0.5) * (1 << _SHIFT)).astype(np.int32)
    ids = np.zeros((height, width), np.int32)
    for number, triangle in zip((order + 1).tolist(), quantised, strict=True):
        cv2.fillConvexPoly(ids, triangle, number, cv2.LINE_8, _SHIFT)
    return ids - 1
