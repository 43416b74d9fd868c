"""The colours of a scanned surface, for viewers: of every vertex, from the pictures that see it."""

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from scipy import sparse
from scipy.ndimage import map_coordinates
from scipy.sparse.linalg import spsolve

from jaxmocap.geometry import uniform_laplacian, vertex_normals

from ._hull import Views, mask_distances
from ._surface import draw_views

_INSIDE = 1.5  # pixels inside the mask from which on a picture shows the person alone
_GRAZING = 0.2  # cosine between normal and line of sight below which a colour is smeared
_PINNED = 1e4  # by which a colour that was seen outweighs one that goes with its neighbours'


def vertex_colours(
    vertices: Float[np.ndarray, "vertex 3"], faces: Int[np.ndarray, "face 3"], views: Views
) -> UInt8[np.ndarray, "vertex 3"]:
    """Find the colour of every vertex, RGB: the weighted median of what the views that see it show there.

    `views` have `pictures`. A view counts by the squared cosine between its line of sight and the normal. A vertex that
    no view sees gets the colour that goes smoothly with its neighbours'.
    """
    assert views.pictures is not None
    normals = vertex_normals(vertices, faces)
    inside = mask_distances(views.masks)
    samples, weights = [], []
    for number, drawn in enumerate(draw_views(vertices, faces, views)):
        rotation, translation = drawn.cam_from_world[:3, :3], drawn.cam_from_world[:3, 3]
        placed = drawn.vertices @ rotation.T + translation
        pixel = placed @ drawn.intrinsics.T
        pixel = (pixel[:, :2] / pixel[:, 2:]).astype(np.float32)
        towards = -(rotation.T @ translation) - drawn.vertices
        cosine = (normals * towards).sum(1) / np.linalg.norm(towards, axis=1)
        shown = _visible(pixel, drawn.ids, faces) & (cosine > _GRAZING)
        shown &= _sampled(inside[number], pixel, drawn.ids.shape) > _INSIDE
        samples.append(_sampled(views.pictures[number], pixel, drawn.ids.shape))
        weights.append(np.where(shown, cosine**2, 0.0))
    weight = np.stack(weights)
    median = np.stack([_weighted_median(np.stack(samples)[..., c], weight) for c in range(3)], axis=-1)
    filled = _filled(median, weight.sum(0) > 0, faces)
    return np.clip(np.round(filled), 0, 255).astype(np.uint8)


def _visible(
    pixel: Float[np.ndarray, "vertex 2"], ids: Int[np.ndarray, "height width"], faces: Int[np.ndarray, "face 3"]
) -> Bool[np.ndarray, " vertex"]:
    """Tell which vertices lie within a pixel of a drawn triangle of their own."""
    height, width = ids.shape
    column, row = np.floor(pixel).astype(int).T
    number, found = np.arange(len(pixel)), np.zeros(len(pixel), bool)
    for down in (-1, 0, 1):
        for right in (-1, 0, 1):
            y, x = row + down, column + right
            there = (y >= 0) & (y < height) & (x >= 0) & (x < width)
            face = np.where(there, ids[np.clip(y, 0, height - 1), np.clip(x, 0, width - 1)], -1)
            found |= (face >= 0) & (faces[np.maximum(face, 0)] == number[:, None]).any(1)
    return found


def _sampled(picture: np.ndarray, pixel: Float[np.ndarray, "vertex 2"], shape: tuple[int, ...]) -> np.ndarray:
    """Look pixels of a picture of `shape` up in one of the same view, bilinearly."""
    height, width = picture.shape[:2]
    column, row = (pixel * [width / shape[1], height / shape[0]] - 0.5).T  # the centre of the first pixel is (0.5, 0.5)
    channels = picture.reshape(height, width, -1).transpose(2, 0, 1)
    found = [map_coordinates(one.astype(np.float32), [row, column], order=1, mode="nearest") for one in channels]
    return np.stack(found, axis=-1).reshape(len(pixel), *picture.shape[2:])


def _weighted_median(values: Float[np.ndarray, "view vertex"], weights: Float[np.ndarray, "view vertex"]) -> np.ndarray:
    order = np.argsort(values, axis=0)
    ordered, share = np.take_along_axis(values, order, 0), np.cumsum(np.take_along_axis(weights, order, 0), axis=0)
    middle = np.argmax(share >= 0.5 * share[-1], axis=0)
    return np.take_along_axis(ordered, middle[None], 0)[0]


def _filled(
    colours: Float[np.ndarray, "vertex 3"], seen: Bool[np.ndarray, " vertex"], faces: Int[np.ndarray, "face 3"]
) -> Float[np.ndarray, "vertex 3"]:
    """Give vertices that were not seen the smoothest colours between those that were."""
    if seen.all() or not seen.any():
        return colours
    laplacian = uniform_laplacian(faces, len(colours))
    pinned = sparse.diags_array(_PINNED * seen.astype(float))
    matrix = sparse.csc_array(laplacian.T @ laplacian + pinned + 1e-9 * sparse.eye_array(len(colours)))
    smooth = np.asarray(spsolve(matrix, pinned @ colours))
    return np.where(seen[:, None], colours, smooth)
