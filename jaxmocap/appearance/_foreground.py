"""The colour model of every mesh triangle, learnt at the selected frames."""

from collections.abc import Sequence
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray, UInt8
from scipy.ndimage import binary_erosion
from scipy.sparse.csgraph import dijkstra

from jaxmocap.geometry import face_adjacency

from ._colour_model import ColourModel, ColourSettings
from ._fit_colours import fit_colour_models


class ForegroundSettings(eqx.Module):
    """Which pixels teach a mesh triangle its colours. All static.

    Attributes:
        unseen: "none": a triangle that no selected frame shows has no model and psi_f = tau (the paper); "nearest": it
            takes the model of the nearest triangle over the surface that has one, so that a limb which turns its unseen
            side keeps being worth covering.
        per_camera: "camera_then_pooled": a camera's own model where it has enough pixels, else that of all cameras;
            "camera": nothing else; "pooled": one model for all cameras.
        pool_ring: 1 lets a triangle with few pixels borrow those of the triangles it shares an edge with; 0 does not.
        pool_below: pixels that are few.
        min_pixels: pixels a model needs, borrowed ones included; a triangle that was never seen gets none.
        min_facing: smallest cosine between normal and view direction.
        erosion: pixels cut off the silhouette.
    """

    unseen: Literal["none", "nearest"] = eqx.field(static=True, default="none")
    per_camera: Literal["camera_then_pooled", "camera", "pooled"] = eqx.field(static=True, default="camera_then_pooled")
    pool_ring: Literal[0, 1] = eqx.field(static=True, default=1)
    pool_below: int = eqx.field(static=True, default=40)
    min_pixels: int = eqx.field(static=True, default=8)
    min_facing: float = eqx.field(static=True, default=0.2)
    erosion: int = eqx.field(static=True, default=1)


@jax.jit
def _one(colours: ColourModel, camera: int) -> ColourModel:
    return jax.tree.map(lambda leaf: leaf[camera], colours)


class ForegroundModel(eqx.Module):
    """Colour models of the mesh triangles per camera.

    `pixel_counts` are the pixels each camera saw of a triangle itself. `source` tells where a model came from: 0 there
    is none (psi_f = tau), 1 the camera, 2 all cameras together, 3 the nearest triangle that was seen.
    """

    colours: ColourModel
    pixel_counts: Int[Array, "camera face"]
    source: Int[Array, "camera face"]

    def camera(self, camera: int) -> ColourModel:
        """Return the models one camera uses."""
        return _one(self.colours, camera)

    def mean_colours(self) -> Float[Array, "camera face 3"]:
        """Average the RGB per triangle, in [0, 1]; zero where `colours.valid` is false."""
        return self.colours.mean_colours()


def face_neighbours(faces: Int[np.ndarray, "face 3"]) -> Int[np.ndarray, "face 3"]:
    """Find the triangle across each edge (0-1, 1-2, 2-0); -1 at an open border."""
    faces = np.asarray(faces)
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    order = np.lexsort(edges.T[::-1])
    same = (edges[order[1:]] == edges[order[:-1]]).all(axis=1)
    owner = np.tile(np.arange(len(faces)), 3)
    across = np.full(len(edges), -1)
    first, second = order[:-1][same], order[1:][same]
    across[first], across[second] = owner[second], owner[first]
    return across.reshape(3, -1).T


def nearest_known(faces: Int[np.ndarray, "face 3"], known: Bool[np.ndarray, " face"]) -> Int[np.ndarray, " face"]:
    """Find for every triangle the nearest known one, in steps over shared edges; itself where none can be reached."""
    if not known.any():
        return np.arange(len(faces))
    _, _, origin = dijkstra(
        face_adjacency(np.asarray(faces)), indices=np.flatnonzero(known), min_only=True, unweighted=True,
        return_predecessors=True,
    )  # fmt: skip
    return np.where(origin >= 0, origin, np.arange(len(faces)))


def usable_pixels(
    ids: Int[np.ndarray, "height width"],
    facing: Float[np.ndarray, "..."],
    silhouette: Bool[np.ndarray, "height width"] | None,
    settings: ForegroundSettings,
) -> Bool[np.ndarray, "height width"]:
    """Mark pixels that are safe to learn from: inside the eroded silhouette, on a triangle that faces the camera.

    `facing` is the cosine per face or per pixel; `silhouette` a person mask that is intersected with the rendered one.
    """
    inside = np.asarray(ids >= 0)
    if silhouette is not None:
        inside = inside & (np.asarray(silhouette) != 0)
    if settings.erosion > 0:
        inside = np.asarray(binary_erosion(inside, iterations=settings.erosion, border_value=1))
    cosine = np.asarray(facing)
    per_pixel = cosine if cosine.shape == ids.shape else cosine[np.maximum(ids, 0)]
    return np.logical_and(inside, per_pixel >= settings.min_facing)


def fit_foreground(
    ids: Sequence[Sequence[Int[np.ndarray, "height width"]]],
    images: Sequence[Sequence[UInt8[np.ndarray, "height width 3"]]],
    facing: Sequence[Sequence[Float[np.ndarray, "..."]]],
    faces: Int[np.ndarray, "face 3"],
    *,
    key: PRNGKeyArray,
    silhouettes: Sequence[Sequence[Bool[np.ndarray, "height width"] | None]] | None = None,
    settings: ForegroundSettings | None = None,
    colour: ColourSettings | None = None,
) -> ForegroundModel:
    """Fit the foreground model of the registered mesh (Sec. 3.2) to all selected frames, per triangle and camera.

    `ids[n][m]` is the triangle rendered at each pixel of camera m in selected frame n (-1: none), `images[n][m]` the
    image of the same size, `facing[n][m]` the cosine of normal and view direction, per face or per pixel,
    `silhouettes[n][m]` a person mask or None.
    """
    settings = ForegroundSettings() if settings is None else settings
    faces = np.asarray(faces)
    num_faces, num_cameras = len(faces), len(ids[0])
    neighbours = face_neighbours(faces)
    pixels = []
    for camera in range(num_cameras):
        parts = []
        for n in range(len(ids)):
            silhouette = None if silhouettes is None else silhouettes[n][camera]
            frame_ids = np.asarray(ids[n][camera])
            used = usable_pixels(frame_ids, facing[n][camera], silhouette, settings)
            parts.append((frame_ids[used], np.asarray(images[n][camera])[used]))
        pixels.append(tuple(np.concatenate(column) for column in zip(*parts, strict=True)))
    counts = np.stack([np.bincount(camera_ids, minlength=num_faces) for camera_ids, _ in pixels])

    groups = []
    if settings.per_camera != "pooled":
        groups += [(camera, *pixels[camera]) for camera in range(num_cameras)]
    if settings.per_camera != "camera":
        groups.append((num_cameras, *(np.concatenate(column) for column in zip(*pixels, strict=True))))
    labelled = [
        (group * num_faces + group_ids, rgb)
        for group, *own in groups
        for group_ids, rgb in [own, *_borrowed(own[0], own[1], neighbours, settings)]
    ]
    everything = fit_colour_models(
        np.concatenate([element for element, _ in labelled]),
        np.concatenate([rgb for _, rgb in labelled]),
        (num_cameras + 1) * num_faces,
        key=key,
        settings=colour,
        min_pixels=settings.min_pixels,
    )
    own = np.asarray(everything.valid).reshape(num_cameras + 1, num_faces)
    source = np.where(own[:-1], 1, np.where(own[-1:], 2, 0))
    face = np.broadcast_to(np.arange(num_faces), source.shape).copy()
    if settings.unseen == "nearest":
        for camera in range(num_cameras):
            face[camera] = nearest_known(faces, source[camera] > 0)
        source = np.where(source == 0, 3 * (source[np.arange(num_cameras)[:, None], face] > 0), source)
    from_camera = np.take_along_axis(own[:-1], face, axis=1)
    row = np.where(from_camera, np.arange(num_cameras)[:, None], num_cameras) * num_faces + face
    colours = jax.tree.map(lambda leaf: leaf[row], everything)
    return ForegroundModel(colours, jnp.asarray(counts), jnp.asarray(source))


def _borrowed(
    ids: np.ndarray, rgb: np.ndarray, neighbours: np.ndarray, settings: ForegroundSettings
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Copy the neighbours' pixels for triangles that were seen, but in too few pixels."""
    if settings.pool_ring == 0:
        return []
    order = np.argsort(ids, kind="stable")
    counts = np.bincount(ids, minlength=len(neighbours))
    starts = np.cumsum(counts) - counts
    poor = np.flatnonzero((counts > 0) & (counts < settings.pool_below))
    borrower = np.repeat(poor, neighbours.shape[1])
    lender = neighbours[poor].ravel()
    borrower, lender = borrower[lender >= 0], lender[lender >= 0]
    lengths = counts[lender]
    within = np.arange(lengths.sum()) - np.repeat(np.cumsum(lengths) - lengths, lengths)
    rows = order[np.repeat(starts[lender], lengths) + within]
    return [(np.repeat(borrower, lengths), rgb[rows])]
