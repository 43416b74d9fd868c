"""A z-buffer in NumPy, written independently of the tracker's rasteriser so that each can check the other."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int


@dataclass(frozen=True)
class Fragments:
    """The visible samples of a mesh.

    Attributes:
        index: flat, into (height, width).
        face: that is seen.
        barycentric: perspective-correct, of its corners.
        inverse_depth: 1/m.
    """

    index: Int[np.ndarray, "sample"]
    face: Int[np.ndarray, "sample"]
    barycentric: Float[np.ndarray, "sample 3"]
    inverse_depth: Float[np.ndarray, "sample"]

    def interpolate(self, faces: Int[np.ndarray, "face 3"], values: np.ndarray) -> np.ndarray:
        """Interpolate values per vertex to the samples."""
        corners = values[faces[self.face]]
        return np.einsum("sc,sc...->s...", self.barycentric, corners)


def visible_fragments(
    camera_points: Float[np.ndarray, "vertex 3"],
    faces: Int[np.ndarray, "face 3"],
    intrinsics: Float[np.ndarray, "3 3"],
    size: tuple[int, int],
    near: float = 0.05,
) -> Fragments:
    """Find the nearest face turned to the camera at the centre of every pixel.

    `camera_points` are in camera coordinates (metres), `size` is (width, height). Faces are counter-clockwise seen from
    outside; those turned away, or with a corner nearer than `near`, are left out. Faces are handled in groups of
    similar size, each as one array of small windows.
    """
    width, height = size
    depth = camera_points[:, 2]
    safe = np.maximum(depth, near)
    pixels = (camera_points @ intrinsics.T)[:, :2] / safe[:, None]
    corners = pixels[faces]
    edges = corners[:, [1, 2]] - corners[:, :1]
    area = edges[:, 0, 0] * edges[:, 1, 1] - edges[:, 0, 1] * edges[:, 1, 0]
    first = np.clip(np.ceil(corners.min(axis=1) - 0.5), 0, (width, height)).astype(int)
    last = np.clip(np.floor(corners.max(axis=1) - 0.5), -1, (width - 1, height - 1)).astype(int)
    extent = (last - first + 1).max(axis=1)
    usable = (area < -1e-12) & (depth[faces].min(axis=1) > near) & (last >= first).all(axis=1)
    found = [np.zeros((0, 6))]
    group_size = 2
    low = 0
    while low < extent[usable].max(initial=0):
        group = np.flatnonzero(usable & (extent > low) & (extent <= group_size))
        for part in np.array_split(group, max(1, len(group) * group_size**2 // 2_000_000)):
            found.append(_windows(part, corners[part], area[part], first[part], last[part], group_size))
        low, group_size = group_size, 2 * group_size
    samples = np.concatenate(found)
    face = samples[:, 2].astype(int)
    scaled = samples[:, 3:] / depth[faces[face]]
    inverse_depth = scaled.sum(axis=1)
    index = samples[:, 1].astype(int) * width + samples[:, 0].astype(int)
    order = np.lexsort((-inverse_depth, index))
    winner = order[np.concatenate([[True], np.diff(index[order]) > 0])[: len(order)]]
    return Fragments(index[winner], face[winner], scaled[winner] / inverse_depth[winner, None], inverse_depth[winner])


def _windows(
    which: np.ndarray, corners: np.ndarray, area: np.ndarray, first: np.ndarray, last: np.ndarray, size: int
) -> np.ndarray:
    """List pixel centres inside the faces of a group, as rows (x, y, face, three screen barycentrics)."""
    offset = np.arange(size)
    x = first[:, 0, None, None] + offset[None, None, :]
    y = first[:, 1, None, None] + offset[None, :, None]
    inside = (x <= last[:, 0, None, None]) & (y <= last[:, 1, None, None])
    weights = []
    for i in range(3):
        a, b = corners[:, (i + 1) % 3], corners[:, (i + 2) % 3]
        slope = (b - a) / area[:, None]
        # Positive inside: area and the edge's cross product have the same sign there.
        weight = (
            slope[:, 0, None, None] * (y + 0.5 - a[:, 1, None, None])
            - slope[:, 1, None, None] * (x + 0.5 - a[:, 0, None, None])
        )  # fmt: skip
        inside &= weight >= 0
        weights.append(weight)
    face, row, column = np.nonzero(inside)
    return np.stack(
        [first[face, 0] + column, first[face, 1] + row, which[face], *(w[face, row, column] for w in weights)], axis=1
    )
