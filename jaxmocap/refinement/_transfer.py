"""Where a view's surface points lie in another picture: one homography per triangle, since both see it flat."""

import numpy as np
from jaxtyping import Bool, Float, Int, UInt32

from jaxmocap.geometry import facing_cosine

from ._views import View

LEAST_DEPTH = 0.05
"""Metres in front of the source's camera that a triangle must lie."""


def homographies(
    here: Float[np.ndarray, "face 3 3"],
    intrinsics: Float[np.ndarray, "3 3"],
    there: Float[np.ndarray, "face 3 3"],
    source_intrinsics: Float[np.ndarray, "3 3"],
) -> Float[np.ndarray, "face 3 3"]:
    """Map a pixel (x, y, 1) of one view to the same point of each triangle in another, up to scale.

    Corners are in the frames of their cameras; the triangle may have moved and bent its edges between the two.
    """
    a, b, c = here[:, 0], here[:, 1], here[:, 2]
    shares = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], 1)  # barycentric coordinates of a ray
    projected = there @ source_intrinsics.T.astype(np.float64)
    return projected.transpose(0, 2, 1) @ shares @ np.linalg.inv(intrinsics.astype(np.float64))


def transfer(
    faces: Int[np.ndarray, "face 3"], near_faces: UInt32[np.ndarray, "face word"], view: View, source: View
) -> tuple[Float[np.ndarray, "height width 2"], Bool[np.ndarray, "height width"], Float[np.ndarray, "height width"]]:
    """Transfer every covered pixel of `view` over the surface into `source`.

    Returns for every pixel where its surface point lies in the source, pixels (x, y), whether the source shows the same
    surface there, and how squarely its triangle faces the camera that sees it less well (cosine). `near_faces` is the
    bit table of Eq. 7, which says what counts as the same surface. What is not seen is left at 0.
    """
    covered = np.flatnonzero(view.ids >= 0)
    number, (height, width) = view.ids.reshape(-1)[covered], view.ids.shape
    marked = np.zeros(len(faces), bool)
    marked[number] = True
    shown, face = faces[marked], (np.cumsum(marked) - 1)[number]  # most faces of a mesh are not seen
    here, there = view.corners(shown), source.corners(shown)
    table = homographies(here, view.intrinsics, there, source.intrinsics)
    squarely = np.minimum(facing_cosine(here), facing_cosine(there)).astype(np.float32)
    row, column = np.divmod(covered, width)
    x, y = column + (view.origin[1] + 0.5), row + (view.origin[0] + 0.5)
    maps = np.ascontiguousarray(table.reshape(-1, 9).T)  # one array per entry: a third of the time of whole matrices
    across, along, depth = (maps[k][face] * x + maps[k + 1][face] * y + maps[k + 2][face] for k in (0, 3, 6))
    with np.errstate(divide="ignore", invalid="ignore"):
        pixel = np.stack([across / depth, along / depth])
    rows, columns = source.ids.shape
    in_front = np.all(there[..., 2] > LEAST_DEPTH, axis=1)[face] & np.isfinite(pixel).all(0)
    pixel = np.where(in_front, pixel, -1.0).clip(-1e6, 1e6)
    right, down = (np.floor(pixel) - np.array(source.origin[::-1])[:, None]).astype(np.int32)
    inside = in_front & (right >= 0) & (down >= 0) & (right < columns) & (down < rows)
    other = source.ids[down.clip(0, rows - 1), right.clip(0, columns - 1)]
    same = near_faces[number, np.maximum(other, 0) >> 5] >> (np.maximum(other, 0) & 31).astype(np.uint32) & 1
    source_pixel, cosine = np.zeros((height, width, 2), np.float32), np.zeros((height, width), np.float32)
    seen = np.zeros((height, width), bool)
    source_pixel.reshape(-1, 2)[covered] = pixel.T
    seen.reshape(-1)[covered] = inside & (other >= 0) & (same == 1)
    cosine.reshape(-1)[covered] = squarely[face]
    return source_pixel, seen, cosine
